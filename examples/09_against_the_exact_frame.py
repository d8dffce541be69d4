"""How wrong is a frame? The exact one has no voxels: float64 fields, dense samples along every ray. Small pictures only.

python examples/09_against_the_exact_frame.py OUT.png [SIZE]
"""

import sys

import numpy as np
import torch

import avatarrex as ax
from avatarrex.files.images import composite, write_png
from avatarrex.reference.error_report import depth_report
from avatarrex.reference.oracle import render_oracle

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 96
avatar, signals = ax.load("default"), ax.Signals.rest().replace(body_pose=ax.named_pose("stand"))
camera = ax.Camera.orbit(azimuth_deg=20, distance=0.9, target=(0, 0.5, 0), width=size, height=size)

exact = render_oracle(avatar, signals, camera)
pictures = [composite(exact.image, (1.0, 1.0, 1.0, 1.0))]
for name in ("paper", "balanced", "quality"):
    frame = ax.render(avatar, signals, camera, ax.level(name))
    error = depth_report(frame, exact)
    print(f"{name}: depth off by {error.depth_mean_mm:.2f} mm in the mean, {error.depth_p99_mm:.1f} mm at 99 %, "
          f"normals by {error.normal_mean_deg:.1f}°, {100 * error.flips:.1f} % flips, colours {error.colour_psnr_db:.0f} dB")  # fmt: skip
    both = frame.pointmap.hit & exact.pointmap.hit
    off = torch.where(both, (frame.pointmap.depth - exact.pointmap.depth).abs(), 0) / 0.005  # 5 mm and more: red
    shade = torch.stack([torch.ones_like(off), 1 - off, 1 - off, torch.ones_like(off)], -1).clamp(0, 1)
    pictures.append(composite(shade.float(), (1.0, 1.0, 1.0, 1.0)))
write_png(out, np.repeat(np.repeat(np.hstack(pictures), 2, 0), 2, 1))
