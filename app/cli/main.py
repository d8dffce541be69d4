"""`avatarrex-studio VERB …`: the table of verbs, each a file of this folder or of `avatarrex.measure`, and how each ends.

Wrong input ends with one line, `avatarrex-studio: error: …`, and exit code 2; Ctrl+C with 130. Only the file of the verb
that was named is loaded, and none loads torch before its options are read.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from avatarrex_studio.cli import PROGRAM, submit
from avatarrex_studio.engine.pages import keep_pages

from avatarrex.errors import InputError

VERBS = {
    "open": "open the window (also without a verb)",
    "render": "render without a display",
    "replay": "render the end of a saved session",
    "export": "an avatar as a file for other programs: GLB, VRM, USD, OBJ, PLY, a web page",
    "models": "body, hand and face models of your own: SMPL-X, MANO, FLAME, Faceverse",
    "motion": "how a motion file is read, beside its own skeleton",
    "inspect": "say what a file or folder contains",
    "runs": "watch trainings: curves, samples, time left",
    "capture": "captures: images of a person from many sides",
    "evaluate": "measure an avatar against a capture's pictures",
    "sheet": "contact sheets of an avatar, and what floats about it",
    "judge": "blind sheets: the truth, and two subjects whose names are hidden",
    "distil": "make an avatar's surface, which level live draws",
    "train": "train an avatar from a capture",
    "bench": "run time against error, stage by stage",
    "bench ablation": "what feature patches, pass II, sampling … are worth, trained for real",
    "stress": "hostile inputs through every stage",
}
"""What each does."""
MEASURING = {"bench": "bench", "bench ablation": "ablation", "stress": "stress"}
"""Verbs that are tools of `avatarrex.measure`, with their rooms there: not needed to run the app."""
RENAMED = {"--recipe": "--preset", "--variants": "--arms"}
"""Options that are still accepted under an older name."""
EPILOGUE = """\
examples:
  avatarrex-studio                                         the window, with the default avatar
  avatarrex-studio render out.png --pose wave --expression smile
  avatarrex-studio render walk.mp4 --motion walk.bvh --frames 0:240:2 --size 640x480
  avatarrex-studio render out.png --set body.left_elbow=0,0,45deg --set face.jawOpen=0.6 --aov depth,normal
  avatarrex-studio train {c} --out runs/{c} --over c=anna,ben --submit slurm   jobs of their own (docs/scale.md)
"""
SIGNED = ("--frame", "--frames", "--held-out-frames", "--size", "--camera", "--up", "--forward")
"""Options whose value may start with a minus."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    try:
        if submit.wanted(words):
            return submit.run(words, parse)
        arguments = parse(words)
        keep_pages()
        code: int = arguments.run(arguments)
        return code
    except InputError as error:
        print(f"{PROGRAM}: error: {_as_typed(str(error), words)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of our output has left (`… | head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # 128 + SIGPIPE
    except (OSError, MemoryError) as error:
        name = getattr(error, "filename", None) or "this machine"
        reason = getattr(error, "strerror", None) or "not enough memory"
        print(f"{PROGRAM}: error: {name}: {reason}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 130


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The options of a command line, and the verb's `run`. Exits with status 2 where a word is wrong."""
    words = _with_verb(list(argv))
    top = _Parser(PROGRAM, description="Create, pose and render full-body avatars in real time.", epilog=EPILOGUE,
                  formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)  # fmt: skip
    verbs = top.add_subparsers(dest="verb", metavar="VERB")
    for name, what in VERBS.items():
        verb = verbs.add_parser(name, help=what, allow_abbrev=False)
        if name == words[0]:
            tool = MEASURING.get(name)
            module = import_module(f"avatarrex.measure.{tool}.command" if tool else f"avatarrex_studio.cli.{name}")
            module.add_options(verb)
            verb.set_defaults(run=module.run, words=words)
    return top.parse_args(words)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: error: {message.splitlines()[0]}\n")


def _as_typed(message: str, words: Sequence[str]) -> str:
    """An error over an option names it as it was typed, though it has another name by now."""
    option, _, rest = message.partition(":")
    typed = {word.partition("=")[0] for word in words}
    return f"{RENAMED[option]}:{rest}" if RENAMED.get(option) in typed else message


def _like_a_path(word: str) -> bool:
    """Whether a word names something on the disk, there or not."""
    return os.path.exists(word) or os.sep in word or "." in word


def _with_verb(words: list[str]) -> list[str]:
    """The verb as one word at the start (`open` where only what it takes is there), values joined to their options."""
    if " ".join(words[:2]) in VERBS:
        words[:2] = [" ".join(words[:2])]
    named = bool(words) and words[0] in VERBS
    opens = not words or words[0].startswith("--device") or (words[0][:1] != "-" and _like_a_path(words[0]))
    joined = ["open"] if opens and not named else []
    for word in words:
        if joined and joined[-1] in SIGNED and word.startswith("-") and not word.startswith("--"):
            joined[-1] += "=" + word  # `--frames -10:-1` reads as `--frames=-10:-1`
        else:
            joined.append(word)
    return joined
