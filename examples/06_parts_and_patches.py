"""Parts and patches: the body without its hands or face, and the colour patches of another pose (the paper's figure).

python examples/06_parts_and_patches.py OUT.png [SIZE]
"""

import sys

import numpy as np

import avatarrex as ax
from avatarrex.files.images import composite, write_png

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 320
avatar, wave = ax.load("default"), ax.Signals.rest().replace(body_pose=ax.named_pose("wave"))
camera = ax.Camera.orbit(azimuth_deg=10, elevation_deg=2, distance=1.5, target=(-0.1, 0.4, 0), width=size, height=size)

variants = {
    "everything": ax.RenderSettings(),
    "without hands": ax.RenderSettings(hidden=frozenset({"left_hand", "right_hand"})),
    "without the face's field": ax.RenderSettings(hidden=frozenset({"face"})),
    "patches of the T-pose": ax.RenderSettings(
        detail_from=ax.Signals.rest()
    ),  # geometry of the wave, colours of another pose
}
pictures = []
for name, settings in variants.items():
    frame = ax.render(avatar, wave, camera, settings)
    pictures.append(composite(frame.image, (1.0, 1.0, 1.0, 1.0)))
    counts = {part: frame.counters[f"{part}_pixels"] for part in ("body", "hand", "face")}
    print(f"{name}: " + ", ".join(f"{count} {part} pixels" for part, count in counts.items()))
write_png(out, np.hstack(pictures))
