"""Expressions and hands: named ones, mixtures of them, and single coefficients.

python examples/03_expressions_and_hands.py OUT.png [SIZE]
"""

import sys

import numpy as np

import avatarrex as ax
from avatarrex.files.images import composite, write_png
from avatarrex.signals.joints import EXPRESSION_NAMES

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 256
avatar, frame, rows = ax.load("default"), None, []
stand = ax.Signals.rest().replace(body_pose=ax.named_pose("arms_up"))

left_brow = np.zeros(52)  # Apple's coefficients, 0 to 1
left_brow[[EXPRESSION_NAMES.index("browOuterUpLeft"), EXPRESSION_NAMES.index("mouthPucker")]] = 1.0
faces = [
    ax.named_expression("smile"),
    0.5 * ax.named_expression("laugh") + 0.5 * ax.named_expression("surprise"),
    ax.named_expression("anger"),
    left_brow,
]
hands = ["fist", "victory", "pinch", "spread"]


def picture(signals: ax.Signals, target: tuple[float, float, float], distance: float) -> np.ndarray:
    """A close view over white; the frame before lends what did not change, here the whole body."""
    global frame
    camera = ax.Camera.orbit(10, 0, distance, target=target, width=size, height=size)
    frame = ax.render(avatar, signals, camera, previous=frame)
    return composite(frame.image, (1.0, 1.0, 1.0, 1.0))


rows.append([picture(stand.replace(expression=face), (0.0, 0.64, 0.05), 0.5) for face in faces])
wrist = tuple(frame.world_from_root[:3, 3] + frame.posed.body.joints[20].numpy() + (0.03, 0.08, 0.0))
rows.append([picture(stand.replace(left_hand_pose=ax.named_hand(h, "left")), wrist, 0.5) for h in hands])
write_png(out, np.vstack([np.hstack(row) for row in rows]))
print(f"{out}: {len(faces)} expressions, {len(hands)} hands")
