"""A portrait: load an avatar, drive it, look at it, save the picture.

python examples/01_portrait.py OUT.png [SIZE]
"""

import sys

import avatarrex as ax
from avatarrex.files.images import composite, write_png

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 512

avatar = ax.load("default")  # or a folder, or an .avatar file
signals = ax.Signals.rest().replace(
    body_pose=ax.named_pose("wave"),
    right_hand_pose=ax.named_hand("spread", "right"),
    expression=ax.named_expression("smile"),
)
camera = ax.Camera.orbit(azimuth_deg=10, elevation_deg=2, distance=1.3, target=(-0.1, 0.55, 0), width=size, height=size)
frame = ax.render(avatar, signals, camera)

write_png(out, composite(frame.image, (1.0, 1.0, 1.0, 1.0)))  # the image is premultiplied: put it over white
print(f"{out}: {frame.ms['total'] / 1000:.1f} s, {frame.counters['pixels_shaded']} pixels; {frame.notes[0]}")
