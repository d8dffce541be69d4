"""What lies under each pixel: depth, normals and world positions, as a picture and as arrays.

python examples/05_depth_normals_positions.py OUT.png [SIZE]
"""

import sys

import numpy as np

import avatarrex as ax
from avatarrex.files.images import write_arrays, write_png

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 384
signals = ax.Signals.rest().replace(body_pose=ax.named_pose("dance"), translation=np.array([0.2, 0.0, 0.1]))
camera = ax.Camera.orbit(azimuth_deg=-20, distance=2.6, target=(0.2, 0, 0.1), width=size, height=size)
frame = ax.render(ax.load("default"), signals, camera)

points = frame.pointmap
hit = points.hit.numpy()  # whether the ray through the pixel's centre meets the surface
depth = points.depth.numpy()  # camera z, metres
turn, shift = frame.world_from_root[:3, :3], frame.world_from_root[:3, 3]
position = points.position.numpy() @ turn.T + shift  # the point map lives in the root frame: the person's own
normal = points.normal.numpy() @ turn.T

write_arrays(out.removesuffix(".png") + ".npz", {"depth": depth, "normal": normal, "position": position, "hit": hit})
near, far = depth[hit].min(), depth[hit].max()
shades = [np.repeat(1 - 0.8 * (depth[..., None] - near) / (far - near), 3, -1), (normal + 1) / 2, position % 0.1 / 0.1]
pictures = [np.where(hit[..., None], np.clip(shade, 0, 1), 1.0) for shade in shades]
pixels = np.rint(255 * np.hstack(pictures)).astype(np.uint8)
write_png(out, np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)]))
print(f"{out}: {hit.sum()} points from {near:.2f} to {far:.2f} m; feet at y = {position[hit][:, 1].min():.2f} m")
