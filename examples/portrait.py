"""A smiling portrait and its depth: load an avatar, drive it, render it, save it.

python examples/portrait.py portrait.png [SIZE]
"""

import sys

import numpy as np

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.files.images import composite, write_arrays, write_png
from avatarrex.pipeline import render_frame
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_expression, named_hand, named_pose

out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 512

avatar = load_avatar()  # or a folder, or an .avatar file
signals = Signals.rest().replace(
    body_pose=named_pose("wave"),
    right_hand_pose=named_hand("spread", "right"),
    expression=named_expression("smile"),
)
camera = Camera.orbit(azimuth_deg=10, elevation_deg=2, distance=1.3, target=(-0.1, 0.55, 0), width=size, height=size)
frame = render_frame(avatar, signals, camera)

write_png(out, composite(frame.image, (1.0, 1.0, 1.0, 1.0)))
write_arrays(out.removesuffix(".png") + ".npz", {"depth": frame.pointmap.depth.numpy().astype(np.float32)})
print(
    f"{out}: {frame.ms['total'] / 1000:.1f} s, {frame.counters['pixels_shaded']} pixels of a person; {frame.notes[0]}"
)

# The same person turned: only rays and colours are computed, the previous frame holds the rest.
turned = Camera.orbit(azimuth_deg=40, elevation_deg=2, distance=1.3, target=(-0.1, 0.55, 0), width=size, height=size)
again = render_frame(avatar, signals, turned, previous=frame)
print(f"another view: {again.ms['total'] / 1000:.1f} s, {again.counters['voxels_evaluated']} voxels")
