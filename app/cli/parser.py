"""The words of the command line: every verb with its options. Loads no torch, so that a wrong word is refused at once."""

from __future__ import annotations

import argparse
import re
from typing import NoReturn

from avatarrex_studio.cli import bench, stress

PROGRAM = "avatarrex-studio"
EPILOGUE = """\
examples:
  avatarrex-studio                                         the window, with the default avatar
  avatarrex-studio render out.png --pose wave --expression smile
  avatarrex-studio render walk.mp4 --motion walk.bvh --frames 0:240:2 --size 640x480
  avatarrex-studio render out.png --set body.left_elbow=0,0,45deg --set face.jawOpen=0.6 --aov depth,normal
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: error: {message.splitlines()[0]}\n")


def parser() -> argparse.ArgumentParser:
    """The options of every verb."""
    top = _Parser(PROGRAM, description="Create, pose and render full-body avatars in real time.", epilog=EPILOGUE,
                  formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)  # fmt: skip
    verbs = top.add_subparsers(dest="verb", metavar="VERB")
    window = verbs.add_parser("open", help="open the window (also without a verb)", allow_abbrev=False)
    window.add_argument("source", nargs="?", default="default", help="an avatar or a saved session")
    _device_option(window)
    render = verbs.add_parser("render", help="render without a display", allow_abbrev=False)
    _render_options(render)
    replay = verbs.add_parser("replay", help="render the end of a saved session", allow_abbrev=False)
    replay.add_argument("session", help="a session saved by the window")
    replay.add_argument("out", nargs="?", help="OUT.png (beside the session unless given)")
    replay.add_argument("--size", metavar="N|WxH", help="pixels (512)")
    inspect = verbs.add_parser("inspect", help="say what an avatar, motion or session file holds", allow_abbrev=False)
    inspect.add_argument("path", help="a file or folder")
    runs = verbs.add_parser("runs", help="watch trainings: curves, samples, time left", allow_abbrev=False)
    runs.add_argument("folder", nargs="?", default="runs", help="a run, or a folder of runs (runs)")
    runs.add_argument("--text", action="store_true", help="a live table in the terminal; needs no display")
    runs.add_argument("--once", action="store_true", help="print the table once and end")
    _capture_options(
        verbs.add_parser("capture", help="captures: images of a person from many sides", allow_abbrev=False)
    )
    _evaluate_options(
        verbs.add_parser("evaluate", help="measure an avatar against a capture's pictures", allow_abbrev=False)
    )
    _sheet_options(
        verbs.add_parser("sheet", help="contact sheets of an avatar, and what floats about it", allow_abbrev=False)
    )
    _train_options(verbs.add_parser("train", help="train an avatar from a capture", allow_abbrev=False))
    measured = verbs.add_parser("bench", help="run time against error, stage by stage", allow_abbrev=False)
    bench.add_options(measured)
    _device_option(measured)
    what = "what feature patches, pass II, sampling … are worth, trained for real"
    bench.add_ablation_options(verbs.add_parser(bench.ABLATION, help=what, allow_abbrev=False))
    stress.add_options(verbs.add_parser("stress", help="hostile inputs through every stage", allow_abbrev=False))
    return top


def _device_option(verb: argparse.ArgumentParser) -> None:
    where = "where the networks run: cpu, cuda, cuda:1, mps, xpu … (cpu)"
    verb.add_argument("--device", default="cpu", type=_device, metavar="D", help=where)


def _device(word: str) -> str:
    """A device as torch writes it; whether it is there is asked once torch is loaded."""
    if not re.fullmatch(r"cpu|(cuda|mps|xpu)(:\d{1,2})?", word):
        raise argparse.ArgumentTypeError(f"expected cpu, cuda, cuda:1, mps or xpu, found {word or 'nothing'}")
    return word


def _train_options(train: argparse.ArgumentParser) -> None:
    add = train.add_argument
    add("capture", help="a folder or .zip")
    add("--out", required=True, metavar="RUN", help="a new folder for the run, or with --resume the one to go on with")
    add("--preset", default="quick", metavar="P", help="paper, quick, long, refine or smoke (quick)")
    add("--parts", metavar="PARTS", help="face, body or face,body (what the capture has)")
    add("--resume", action="store_true", help="go on from the run's last checkpoint")
    add("--seed", default="0", metavar="N", help="of everything random (0)")
    add("--held-out-frames", metavar="A:B:S", help="frames kept from training, instead of the capture's own")
    add("--held-out-views", metavar="NAMES", help="body cameras kept from training, instead of the capture's own")
    add("--start", metavar="AVATAR", help="an avatar to go on from (with --preset refine), in place of the template")
    add("--mixed", action="store_true", help="colours in bfloat16 while training: for a processor with units for it")
    _device_option(train)
    for part in ("body", "face"):
        add(f"--{part}-views", metavar="NAMES", help=f"{part} cameras to train on alone")


def _sheet_options(sheet: argparse.ArgumentParser) -> None:
    add = sheet.add_argument
    add("avatar", help="name, folder or .avatar file")
    add("out", metavar="OUT_DIR", help="a folder for body.jpg, face.jpg, hands.jpg, motion.jpg and sheet.json")
    add("--truth", metavar="S", help="the clothed subject beside every picture: subject or loose")
    add(
        "--motion",
        metavar="FILE",
        help="motion.jpg: frames of .bvh, .npz (SMPL-X, AMASS), .csv (Live Link Face) or .json",
    )
    add("--other", metavar="AVATAR2", help="a second avatar that follows the same motion")
    add("--frames", metavar="A:B:S", help="frames of the motion (8, evenly spaced)")
    add("--only", metavar="NAMES", help="some of body,face,hands,motion,floaters (all)")
    add("--samples", default="2", metavar="N", help="samples averaged along each side of a pixel (2)")


def _evaluate_options(evaluate: argparse.ArgumentParser) -> None:
    add = evaluate.add_argument
    add("avatar", help="name, folder or .avatar file")
    add("capture", help="a folder or .zip")
    add("--rig", choices=("body", "face"), help="body, where there is one")
    add("--frames", metavar="A:B:S,…", help="frames A to B (not included) in steps of S, or held-out (4 of each split)")
    add("--views", metavar="NAMES", help="cameras by name or number, comma separated (all)")
    add("--held-out-frames", metavar="A:B:S", help="frames that were not trained on, instead of the capture's own")
    add("--held-out-views", metavar="NAMES", help="cameras that were not trained on, instead of the capture's own")
    add("--size", metavar="N", help="pixels of the longer side at most (the capture's)")
    add("--samples", metavar="N", help="samples averaged along each side of a pixel (1, what the window shows)")
    add("--baselines", action="store_true", help="the skinned textured and mean-colour template beside it")
    add("--face-only", action="store_true", help="everything cut by where the template's face is seen")
    add("--json", metavar="FILE.json", help="every figure")
    add("--sheet", metavar="OUT.png", help="a contact sheet: ground truth, avatar, difference")
    add("--vgg", metavar="FILE", help="vgg16-397923af.pth, for LPIPS (or AVATARREX_VGG, or torch hub's folder)")
    add("--lpips", metavar="FILE", help="the linear heads: lpips' vgg.pth or its wheel (or AVATARREX_LPIPS)")
    add("--inception", metavar="FILE", help="pt_inception-2015-12-05-6726825d.pth, for FID (or AVATARREX_INCEPTION)")
    _device_option(evaluate)


def _capture_options(capture: argparse.ArgumentParser) -> None:
    acts = capture.add_subparsers(dest="act", metavar="ACT", required=True)
    make = acts.add_parser("make", help="a synthetic capture of the default subject", allow_abbrev=False)
    make.add_argument("out", help="a new folder, or one to go on with; OUT.zip with --format zip")
    make.add_argument("--size", default="small", metavar="S", help="smoke, small or paper (small)")
    make.add_argument("--seed", default="0", metavar="N", help="varies motions, hands and expressions (0)")
    make.add_argument("--garment", default="printed", metavar="G", help="printed or loose (printed)")
    make.add_argument("--format", default="folder", metavar="F", help="folder or zip (folder)")
    check = acts.add_parser(
        "check", help="how well a capture's pictures, cameras and parameters fit", allow_abbrev=False
    )
    check.add_argument("capture", help="a folder or .zip")
    check.add_argument(
        "--out", metavar="DIR", help="contact sheets with the template drawn over the images, and check.json"
    )
    check.add_argument("--surface", action="store_true", help="fit the template's skin to the mattes first (a minute)")
    check.add_argument("--rig", choices=("body", "face"), help="one rig alone")
    check.add_argument("--frames", default="4", metavar="N", help="how many frames to compare (4)")


def _render_options(render: argparse.ArgumentParser) -> None:
    add = render.add_argument
    add("out", help="OUT.png, OUT.mp4, or a folder for frame_000000.png …")
    add("--avatar", default="default", metavar="A", help="name, folder or .avatar file")
    add("--motion", metavar="FILE", help=".bvh, .npz (SMPL-X, AMASS), .csv (Live Link Face) or .json")
    which = render.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", help="one frame of the motion")
    which.add_argument("--frames", metavar="A:B:S", help="frames A to B (not included) in steps of S")
    add("--size", metavar="N|WxH", help="pixels (512)")
    add(
        "--camera",
        metavar="K=V,…",
        help="azimuth, elevation, fov in degrees, distance in metres; x, y, z of the target; follow=0|1",
    )
    settings = "body.left_elbow=0,0,45deg  face.jawOpen=0.6  left_hand.index1=0,0,-30deg  root.translation=0,0,1"
    add("--set", action="append", default=[], metavar="GROUP.NAME=VALUE", help=settings + "  shape.0=1")
    add("--pose", action="append", default=[], metavar="NAME", help="a named body pose")
    add("--hand", action="append", default=[], metavar="SIDE=NAME", help="a named hand pose: left=fist, both=relaxed")
    add("--expression", action="append", default=[], metavar="NAME", help="a named expression")
    add("--detail-from", metavar="POSE", help="feature patches of another pose: a named one, or MOTION:FRAME")
    add(
        "--level",
        default="balanced",
        metavar="L",
        help="fast, balanced, fine, quality or paper: time against error (balanced)",
    )
    add("--alpha", action="store_true", help="transparent background (straight alpha)")
    add("--aov", metavar="NAMES", help="depth,normal,position,mask as .npz beside the image")
    add("--background", metavar="COLOUR", help="name, #rrggbb, r,g,b or transparent")
    add("--stats", metavar="FILE.json", help="time and work of every frame")
    _device_option(render)
