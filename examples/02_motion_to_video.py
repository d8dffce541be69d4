"""A motion as a video: resample it, follow the person, give each frame to the next. Needs the `video` extra.

python examples/02_motion_to_video.py OUT.mp4 [SIZE] [MOTION]

MOTION is a .bvh, .npz (SMPL-X, AMASS), .csv (Live Link Face) or .json; without one the avatar waves.
"""

import sys

from tqdm import tqdm

import avatarrex as ax
from avatarrex.files.images import composite
from avatarrex.files.video import video_writer

if not sys.argv[1:] or any(word.startswith("-") for word in sys.argv[1:]):
    sys.exit(__doc__)
out, size = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 384
if len(sys.argv) > 3:
    motion = ax.read_motion(sys.argv[3])
else:
    poses = [ax.named_pose(name) for name in ("stand", "wave", "stand")]
    motion = ax.SignalSequence(tuple(ax.Signals.rest().replace(body_pose=pose) for pose in poses), fps=2.0)
motion = motion.resample(8.0)  # rotations on their shortest arcs

avatar, frame = ax.load("default"), None
with video_writer(out, size, size, motion.fps) as append:
    for signals in tqdm(motion, unit="frame"):
        x, _, z = signals.translation
        camera = ax.Camera.orbit(20, 5, 3.0, target=(x, -0.05, z), width=size, height=size)
        frame = ax.render(avatar, signals, camera, ax.level("fast"), previous=frame)
        append(composite(frame.image, (0.15, 0.16, 0.18, 1.0)))
print(f"{out}: {len(motion)} frames, {motion.duration:.1f} s")
