"""A motion file as a video: read it, resample it, render every frame, follow the person. Needs the `video` extra.

python examples/play_motion.py walk.bvh walk.mp4 [SIZE] [FRAMES_A_SECOND]
"""

import sys

from tqdm import tqdm

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.files.images import VideoWriter, composite
from avatarrex.pipeline import render_frame
from avatarrex.signals.read import read_motion

source, out = sys.argv[1:3]
size = int(sys.argv[3]) if len(sys.argv) > 3 else 384
fps = float(sys.argv[4]) if len(sys.argv) > 4 else 12.0

motion = read_motion(source)  # .bvh, .npz (SMPL-X, AMASS), .csv (Live Link Face) or .json
for note in motion.notes:
    print(note)
motion = motion.resample(fps)

avatar, frame = load_avatar(), None
with VideoWriter(out, size, size, fps) as video:
    for signals in tqdm(motion, unit="frame"):
        x, _, z = signals.translation
        camera = Camera.orbit(20, 5, 3.0, target=(x, -0.05, z), width=size, height=size)
        frame = render_frame(avatar, signals, camera, previous=frame)
        video.write(composite(frame.image, (0.15, 0.16, 0.18, 1.0)))
print(f"{out}: {len(motion)} frames, {motion.duration:.1f} s")
