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

from avatarrex.errors import InputError

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
    _capture_options(
        verbs.add_parser("capture", help="captures: images of a person from many sides", allow_abbrev=False)
    )
    return top


def _capture_options(capture: argparse.ArgumentParser) -> None:
    acts = capture.add_subparsers(dest="act", metavar="ACT", required=True)
    check = acts.add_parser(
        "check", help="how well a capture's pictures, cameras and parameters fit", allow_abbrev=False
    )
    check.add_argument("capture", help="a folder or .zip")
    check.add_argument(
        "--out", metavar="DIR", help="contact sheets with the template drawn over the images, and check.json"
    )
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
    add("--alpha", action="store_true", help="transparent background (straight alpha)")
    add("--aov", metavar="NAMES", help="depth,normal,position,mask as .npz beside the image")
    add("--background", metavar="COLOUR", help="name, #rrggbb, r,g,b or transparent")
    add("--stats", metavar="FILE.json", help="time and work of every frame")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    verbs = ("open", "render", "replay", "inspect", "capture")
    if words and words[0] not in verbs and not words[0].startswith("-") and Path(words[0]).exists():
        words.insert(0, "open")
    try:
        arguments = parser().parse_args(_joined(words))
        run = {
            None: _open,
            "open": _open,
            "render": _render,
            "replay": _replay,
            "inspect": _inspect,
            "capture": _capture,
        }
        return run[arguments.verb](arguments)
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read our words has left (`… | head`); nothing more can be said to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # 128 + SIGPIPE
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 130


def _joined(words: list[str]) -> list[str]:
    """Lets an option's value start with a minus: `--frames -10:-1` reads as `--frames=-10:-1`."""
    taking = ("--frame", "--frames", "--size", "--camera")
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in taking and word.startswith("-") and not word.startswith("--"):
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def _open(arguments: argparse.Namespace) -> int:
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        print(f"{PROGRAM}: error: no display; without one use `{PROGRAM} render OUT.png`", file=sys.stderr)
        return 2
    from avatarrex_studio.window import run_window

    return run_window(getattr(arguments, "source", "default"))


def _render(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import headless
    from avatarrex_studio.engine import Engine

    _say(headless.run(headless.job(arguments), Engine()))
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import headless, options
    from avatarrex_studio.engine import Engine
    from avatarrex_studio.journal import Journal

    state = Journal.load(arguments.session).state
    out = Path(arguments.out or Path(arguments.session).with_suffix(".png"))
    if out.suffix.lower() != ".png":
        raise InputError(out, "", "OUT.png", out.suffix or "no extension")
    size = options.size(arguments.size) if arguments.size else state.size.fixed or headless.DEFAULT_SIZE
    _say(headless.run(headless.Job(out, "image", state, None, (0,), (), size, (), None), Engine()))
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    from avatarrex_studio.inspection import describe

    print("\n".join(describe(arguments.path)))
    return 0


def _capture(arguments: argparse.Namespace) -> int:
    from avatarrex_studio import capture_check

    return {"check": capture_check.run}[arguments.act](arguments)


def _say(written: list[Path]) -> None:
    if len(written) > 6:
        print(f"{written[0]} … {written[-1]} ({len(written)} files)")
    else:
        print("\n".join(map(str, written)))
