"""`avatarrex-studio`: the window, headless rendering, replay of a session, and what a file is.

Wrong input ends with one line, `avatarrex-studio: error: …`, and exit code 2; Ctrl+C with 130.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from avatarrex_studio import bench, stress

from avatarrex.errors import InputError
from avatarrex.files import check_writable

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
    bench.add_options(verbs.add_parser("bench", help="run time against error, stage by stage", allow_abbrev=False))
    what = "what feature patches, pass II, sampling … are worth, trained for real"
    bench.add_ablation_options(verbs.add_parser(bench.ABLATION, help=what, allow_abbrev=False))
    stress.add_options(verbs.add_parser("stress", help="hostile inputs through every stage", allow_abbrev=False))
    return top


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
    add("--frames", metavar="A:B:S", help="frames A to B (not included) in steps of S (4 of each split)")
    add("--views", metavar="NAMES", help="cameras by name or number, comma separated (all)")
    add("--held-out-frames", metavar="A:B:S", help="frames that were not trained on, instead of the capture's own")
    add("--held-out-views", metavar="NAMES", help="cameras that were not trained on, instead of the capture's own")
    add("--size", metavar="N", help="pixels of the longer side at most (the capture's)")
    add("--samples", metavar="N", help="samples averaged along each side of a pixel (1, what the window shows)")
    add("--baselines", action="store_true", help="the skinned textured and mean-colour template beside it")
    add("--json", metavar="FILE.json", help="every figure")
    add("--sheet", metavar="OUT.png", help="a contact sheet: ground truth, avatar, difference")
    add("--vgg", metavar="FILE", help="vgg16-397923af.pth, for LPIPS (or AVATARREX_VGG, or torch hub's folder)")
    add("--lpips", metavar="FILE", help="the linear heads: lpips' vgg.pth or its wheel (or AVATARREX_LPIPS)")
    add("--inception", metavar="FILE", help="pt_inception-2015-12-05-6726825d.pth, for FID (or AVATARREX_INCEPTION)")


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
        help="fast, balanced, quality or paper: time against error (balanced)",
    )
    add("--alpha", action="store_true", help="transparent background (straight alpha)")
    add("--aov", metavar="NAMES", help="depth,normal,position,mask as .npz beside the image")
    add("--background", metavar="COLOUR", help="name, #rrggbb, r,g,b or transparent")
    add("--stats", metavar="FILE.json", help="time and work of every frame")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    verbs = ("open", "render", "replay", "inspect", "capture", "train", "evaluate", "sheet", "runs", "bench", "stress")
    if words and words[0] not in verbs and not words[0].startswith("-") and os.path.exists(words[0]):
        words.insert(0, "open")
    try:
        if " ".join(words[:2]) == bench.ABLATION:
            words[:2] = [bench.ABLATION]
        arguments = parser().parse_args(_joined(words))
        run = {
            None: _open,
            "open": _open,
            "render": _render,
            "replay": _replay,
            "inspect": _inspect,
            "capture": _capture,
            "evaluate": _evaluate,
            "sheet": _sheet,
            "train": _train,
            "runs": _runs,
            "bench": bench.run,
            bench.ABLATION: bench.run_ablation,
            "stress": stress.run,
        }
        return run[arguments.verb](arguments)
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read our words has left (`… | head`); nothing more can be said to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # 128 + SIGPIPE
    except (OSError, MemoryError) as error:
        name = getattr(error, "filename", None) or "this machine"
        said = getattr(error, "strerror", None) or "not enough memory"
        print(f"{PROGRAM}: error: {name}: {said}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 130


def _joined(words: list[str]) -> list[str]:
    """Lets an option's value start with a minus: `--frames -10:-1` reads as `--frames=-10:-1`."""
    taking = ("--frame", "--frames", "--held-out-frames", "--size", "--camera")
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in taking and word.startswith("-") and not word.startswith("--"):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def _open(arguments: argparse.Namespace) -> int:
    if _no_display(f"{PROGRAM} render OUT.png"):
        return 2
    from avatarrex_studio.window import run_window

    return run_window(getattr(arguments, "source", "default"))


def _runs(arguments: argparse.Namespace) -> int:
    if arguments.text or arguments.once:
        from avatarrex_studio.runs_text import show

        return show(arguments.folder, arguments.once)
    if _no_display(f"{PROGRAM} runs {arguments.folder} --text"):
        return 2
    from avatarrex_studio.runs_window import run_window

    return run_window(arguments.folder)


def _no_display(instead: str) -> bool:
    """Whether there is no display to open a window on; says so, and what to do `instead`."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return False
    print(f"{PROGRAM}: error: no display; without one use `{instead}`", file=sys.stderr)
    return True


def _render(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.job import read_job

    job = read_job(arguments)
    from avatarrex_studio import headless  # needs torch, which takes seconds to load: wrong options are refused before
    from avatarrex_studio.engine import Engine

    from avatarrex.pipeline import RenderSettings

    _say(headless.run(job, Engine(settings=RenderSettings(detail_from=job.detail))))
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import options
    from avatarrex_studio.job import DEFAULT_SIZE, Job
    from avatarrex_studio.journal import Journal

    state = Journal.load(arguments.session).state
    out = Path(arguments.out or Path(arguments.session).with_suffix(".png"))
    if out.suffix.lower() != ".png":
        raise InputError(out, "", "OUT.png", out.suffix or "no extension")
    check_writable(out)
    size = options.size(arguments.size) if arguments.size else state.size.fixed or DEFAULT_SIZE
    job = Job(out, "image", state, None, (0,), (), size, (), None)
    from avatarrex_studio import headless
    from avatarrex_studio.engine import Engine

    _say(headless.run(job, Engine()))
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.inspection import describe

    print("\n".join(describe(arguments.path)))
    return 0


def _capture(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import capture_check, capture_make

    return {"check": capture_check.run, "make": capture_make.run}[arguments.act](arguments)


def _train(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import train

    return train.run(arguments)


def _evaluate(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import evaluate

    return evaluate.run(arguments)


def _sheet(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.sheet_order import read_order

    order = read_order(arguments)
    from avatarrex_studio import sheet  # needs torch

    return sheet.run(order)


def _say(written: list[Path]) -> None:
    if len(written) > 6:
        print(f"{written[0]} … {written[-1]} ({len(written)} files)")
    else:
        print("\n".join(map(str, written)))
