"""A capture: the synthetic subject before a ring of cameras, and the avatar in the same pose before the same camera.

python examples/10_capture_to_compare.py OUT.png [SIZE] [CAPTURE]

`avatarrex-studio train CAPTURE --out RUN` makes an avatar from it, `evaluate` measures one on all of its pictures.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch

import avatarrex as ax
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.capture.synthetic.make import make_capture
from avatarrex.files.images import composite, write_png
from avatarrex.metrics.drawing import AvatarDrawer, fitted, over_black
from avatarrex.metrics.image import psnr

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 128
avatar, rows = AvatarDrawer(ax.load("default")), []
with tempfile.TemporaryDirectory() as folder:
    path = Path(sys.argv[3]) if len(sys.argv) > 3 else make_capture(Path(folder) / "smoke", "smoke")
    rig = open_capture(path).rigs["body"]  # calibrated cameras, pictures with mattes, and the pose of every frame
    print(f"{len(rig.views)} cameras, {rig.frames} frames")
    for view in range(min(4, len(rig.views))):
        camera = fitted(rig.views[view].camera, size)
        truth = over_black(rig.image(view, 0), rig.matte(view, 0), camera.width, camera.height)
        drawn = avatar.draw(rig.signals[0], camera)
        inside = truth.matte >= 0.5
        found = psnr(
            *(image[..., :3].permute(2, 0, 1)[None] for image in (drawn.image, truth.image)), inside[None]
        ).item()
        print(f"{rig.views[view].name}: {found:.1f} dB inside the matte")
        beside = torch.cat([truth.image, truth.matte[..., None]], -1)
        rows.append(np.hstack([composite(image, (0.0, 0.0, 0.0, 1.0)) for image in (beside, drawn.image)]))
write_png(out, np.hstack(rows))
