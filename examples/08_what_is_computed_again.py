"""What a change costs: every frame gets the one before, and its counters say which stages ran.

python examples/08_what_is_computed_again.py OUT.png [SIZE]
"""

import sys

import numpy as np

import avatarrex as ax
from avatarrex.files.images import composite, write_png

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 256
avatar = ax.load("default")
columns = ("voxels_evaluated", "face_evaluations", "hand_distances", "rays", "pixels_shaded")


def camera(azimuth: float) -> ax.Camera:
    return ax.Camera.orbit(azimuth, distance=1.4, target=(0, 0.45, 0), width=size, height=size)


stand = ax.Signals.rest().replace(body_pose=ax.named_pose("stand"))
smiling = stand.replace(expression=ax.named_expression("smile"))
fist = smiling.replace(left_hand_pose=ax.named_hand("fist", "left"))
moved = fist.replace(translation=np.array([0.0, 0.0, 0.2]))
waving = moved.replace(body_pose=ax.named_pose("wave"))
steps = [
    ("first frame", stand, camera(0)),
    ("nothing", stand, camera(0)),
    ("camera", stand, camera(25)),
    ("expression", smiling, camera(25)),
    ("a hand", fist, camera(25)),
    ("place", moved, camera(25)),
    ("body pose", waving, camera(25)),
]
frame, pictures = None, []
print(f"{'changed':14}{'ms':>8}" + "".join(f"{name:>18}" for name in columns))
for name, signals, view in steps:
    frame = ax.render(avatar, signals, view, previous=frame)
    pictures.append(composite(frame.image, (1.0, 1.0, 1.0, 1.0)))
    print(f"{name:14}{frame.ms['total']:8.0f}" + "".join(f"{frame.counters[column]:18}" for column in columns))
write_png(out, np.hstack(pictures))
