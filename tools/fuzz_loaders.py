"""Broken and hostile files for every loader, until the time is over: models, captures, motions, avatars, sessions, pictures …

    python tools/fuzz_loaders.py [--seed N] [--seconds S] [--files N] [--kind K] [--keep FOLDER]

Takes the sound samples of tests/files/samples.py and breaks one file of each: bytes, texts and numbers, members of zips with their checksums
made anew, headers of arrays, objects of pickles, planted code, control characters. Workers read them; a seed repeats the files. Wrong is:
planted code that ran, anything but an `InputError`, 20 s of a processor, 1 GiB above an idle process, a refusal of several lines or with
control characters, and such characters in what would be printed. What is wrong is listed, its files are kept in FOLDER. Exit code 1 then.
`--seconds` are the processor's, without the making of the samples.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fuzz_bytes import broken

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS / room) for room in ("", "files", "app", "capture", "templates")]
LONGEST, STUCK = 20.0, 120.0
"""Seconds of a processor, and by the clock, for one file."""
MOST = 2**30
"""Bytes above an idle process."""
WORKER_FILES = 1000
"""Files that one worker reads."""


@dataclass(frozen=True)
class Found:
    """Of a file that was read."""

    number: int
    kind: str
    wrong: str
    """Empty where nothing is."""
    refused: bool
    seconds: float
    mib: float


class _TooLong(BaseException):
    """So that nothing holds it for a damaged file."""


def too_long(*_: object) -> None:
    """Of the timer."""
    raise _TooLong


def judged(read: Callable[[Path], object], path: Path) -> tuple[str, bool]:
    """What is wrong with how a file is read, and whether it was refused."""
    from avatarrex.errors import InputError

    shown = io.StringIO()
    handler = logging.StreamHandler(shown)
    handler.setFormatter(logging.Formatter("%(message)s"))
    logging.getLogger().handlers = [handler]
    refused = False
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
            told = read(path)
        if isinstance(told, list | tuple) and all(isinstance(line, str) for line in told):
            shown.write("\n".join(told))
    except InputError as error:
        refused = True
        if not str(error).isprintable():
            return f"a refusal that is no plain line: {str(error)!r}", True
    except _TooLong:
        return "too long:\n" + traceback.format_exc(), False
    except Exception:
        return traceback.format_exc(), False
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    letters = shown.getvalue().replace("\n", " ").replace("\t", " ")
    return ("" if letters.isprintable() else f"control characters are shown: {letters!r}"[:2000]), refused


def work(seed: int, first: int, kind: str, folder: Path) -> None:
    """Read files from `first` on, and print a line of JSON before and after each, as long as the other side takes them."""
    from samples import samples

    signal.signal(signal.SIGPROF, too_long)
    warnings.simplefilter("ignore")
    chosen = [sample for sample in samples() if kind in ("", sample.kind)]
    weights = [sample.weight for sample in chosen]
    idle = memory()
    print(json.dumps({"ready": len(chosen)}), flush=True)
    for number in range(first, first + WORKER_FILES):
        rng = random.Random(f"{seed} {number}")
        (sample,) = rng.choices(chosen, weights)
        place = folder / str(number)
        write(place, broken(sample.files, rng))
        print(json.dumps({"number": number, "kind": sample.kind}), flush=True)
        os.chdir(place)
        Path("/proc/self/clear_refs").write_text("5")
        began = time.process_time()
        wrong, refused = judged(sample.read, place / sample.entry)
        seconds, mib = time.process_time() - began, (memory("VmHWM") - idle) / 2**20
        wrong = wrong or ("too much memory" if mib * 2**20 > MOST else "")
        wrong = "planted code ran" if canaries(place) else wrong
        os.chdir(folder)
        if not wrong:
            shutil.rmtree(place)
        said = {
            "number": number,
            "kind": sample.kind,
            "wrong": wrong,
            "refused": refused,
            "seconds": seconds,
            "mib": mib,
        }
        print(json.dumps({"found": said}), flush=True)


def canaries(place: Path) -> bool:
    """Whether what was planted has left its mark."""
    return any(path.exists() for path in (place / "CANARY", place.parent / "CANARY", Path("/tmp/CANARY")))


def memory(which: str = "VmRSS") -> int:
    """Bytes of this process."""
    return 1024 * int(re.search(rf"{which}:\s*(\d+)", Path("/proc/self/status").read_text())[1])  # type: ignore[index]


def write(place: Path, files: dict[str, bytes]) -> None:
    """Files in a new folder."""
    for name, content in files.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(content)


def fuzzed(seed: int, kind: str, folder: Path, first: int = 0) -> Iterator[Found]:
    """What workers find, from file `first` on; one that stands still or ends is replaced, and that is found, too."""
    while True:
        words = ["--work", str(first), "--seed", str(seed), "--kind", kind, "--keep", str(folder)]
        worker = subprocess.Popen([sys.executable, __file__, *words], stdout=subprocess.PIPE, text=True)
        assert worker.stdout is not None
        begun: dict[str, Any] | None = None
        before = first
        signal.signal(signal.SIGALRM, lambda *_, worker=worker: worker.kill())
        try:
            for line in worker.stdout:
                signal.alarm(int(STUCK))
                said = json.loads(line)
                if "found" in said:
                    first, begun = said["found"]["number"] + 1, None
                    yield Found(**said["found"])
                elif "number" in said:
                    begun = said
        finally:
            signal.alarm(0)
            worker.kill()
            worker.wait()
            worker.stdout.close()
        if begun is None and (worker.returncode > 0 or first == before):
            raise RuntimeError(f"the worker has failed at file {first} ({worker.returncode})")
        if begun is not None:
            first = begun["number"] + 1
            yield Found(
                begun["number"], begun["kind"], f"the reader ended or stood still ({worker.returncode})", False, 0, 0
            )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--seed", type=int, default=0)
    add("--seconds", type=float, default=60.0, help="of a processor (60)")
    add("--files", type=int, default=sys.maxsize, help="at most so many")
    add("--kind", default="", help="one kind of file alone")
    add("--keep", type=Path, help="where files that are read wrongly stay")
    add("--first", type=int, default=0, metavar="N", help="begin with file N of the seed")
    add("--work", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        work(options.seed, options.work, options.kind, options.keep)
        return 0
    with TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        return report(options, folder.resolve())


def report(options: argparse.Namespace, folder: Path) -> int:
    """Read until the time is over and say what was found."""
    kinds: Counter[str] = Counter()
    refused, wrong, spent, longest, most = 0, [], 0.0, 0.0, 0.0
    for found in fuzzed(options.seed, options.kind, folder, options.first):
        kinds[found.kind] += 1
        refused, spent = refused + found.refused, spent + found.seconds
        longest, most = max(longest, found.seconds), max(most, found.mib)
        if found.wrong:
            wrong.append(found)
            again = f"--seed {options.seed} --first {found.number} --files 1"
            print(f"--- {found.kind}: {again}\n{found.wrong.strip()}", flush=True)
        if spent >= options.seconds or kinds.total() >= options.files:
            break
    print(", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items())))
    print(
        f"seed {options.seed}: {kinds.total()} files, {refused} refused, {len(wrong)} read wrongly; {spent:.0f} s, "
        f"the longest {longest:.1f} s, the most memory {most:.0f} MiB"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
