"""Levels: the same picture from the quickest to the most exact, each with its error beside its time.

python examples/04_levels.py OUT.png [SIZE]
"""

import sys

import numpy as np

import avatarrex as ax
from avatarrex.files.images import composite, write_png
from avatarrex.levels import DEFERRED_LEVELS
from avatarrex.reference.level_errors import level_errors

out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 320
avatar, signals = ax.load("default"), ax.Signals.rest().replace(body_pose=ax.named_pose("hands_on_hips"))
camera = ax.Camera.orbit(azimuth_deg=30, elevation_deg=5, distance=1.2, target=(0.05, 0.1, 0), width=size, height=size)

pictures = []
for settings in DEFERRED_LEVELS.values():
    ax.render(avatar, signals, camera.resized(16, 16), settings)  # the first frame of a process also compiles
print(f"{'level':10}{'seconds':>8}{'depth error, mean':>20}{'99 %':>10}")
for name in DEFERRED_LEVELS:
    frame = ax.render(avatar, signals, camera, ax.level(name))
    pictures.append(composite(frame.image, (1.0, 1.0, 1.0, 1.0)))
    error = level_errors()[name]  # measured against the exact frame, over poses and views (docs/accuracy.md)
    print(f"{name:10}{frame.ms['total'] / 1000:8.2f}{error.depth_mean_mm:17.2f} mm{error.depth_p99_mm:7.1f} mm")
write_png(out, np.hstack(pictures))
