"""A motion of another skeleton: read it, see what the reader decided, change it, save it as JSON, look at key frames.

python examples/07_retarget_a_motion.py OUT.png [SIZE] [MOTION]

Writes OUT.json, too, which `avatarrex-studio` and `read_motion` take like any other motion.
"""

import sys
from pathlib import Path

import numpy as np

import avatarrex as ax
from avatarrex.files.images import composite, write_png
from avatarrex.signals.library import mirror
from avatarrex.signals.limits import violations

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 256
source = sys.argv[3] if len(sys.argv) > 3 else Path(__file__).with_name("march.bvh")  # a skeleton of 19 joints in cm

motion = ax.read_motion(source)
print(f"{motion.name}: {len(motion)} frames at {motion.fps:g} a second")
for note in motion.notes:
    print("-", note)
hard = [k for k, signals in enumerate(motion) if violations(signals)]
print(f"joints beyond their limits in {len(hard)} frames")

mirrored = ax.SignalSequence(tuple(mirror(signals) for signals in motion), motion.fps, motion.name + ", mirrored")
saved = out.removesuffix(".png") + ".json"
ax.write_motion(saved, mirrored)
again = ax.read_motion(saved)

avatar, pictures = ax.load("default"), []
for k in np.linspace(0, len(again) - 1, 6)[1:].astype(int).tolist():
    x, _, z = again[k].translation
    camera = ax.Camera.orbit(azimuth_deg=40, distance=2.8, target=(x, -0.05, z), width=size, height=size)
    pictures.append(composite(ax.render(avatar, again[k], camera).image, (1.0, 1.0, 1.0, 1.0)))
write_png(out, np.hstack(pictures))
