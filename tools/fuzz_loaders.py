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
import pickle
import random
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS / room) for room in ("", "files", "app", "capture", "templates")]
LONGEST, STUCK = 20.0, 120.0
"""Seconds of a processor, and by the clock, for one file."""
MOST = 2**30
"""Bytes above an idle process."""
WORKER_FILES = 1000
"""Files that one worker reads."""
NUMBERS = (
    b"nan", b"inf", b"-1", b"1e999", b"1" + b"0" * 400, b"0", b"99999999999", b"-0.0", b"true", b"null", b'""', b"[]", b"{}", b'"\x1b[2J"',
    b"1e38", b"2147483648", b"18446744073709551616", b"0x10", b"[[[[]]]]", b"1e-320",
)  # fmt: skip
WORDS = (
    b"\x1b]0;owned\x07", b"\x00", b"\r\n", b"\xff\xfe", b"../" * 8, b"\xe2\x80\xae", b"A" * 5000,
    b"%s%n", b"!!python/object/apply:os.system", b"\x9b31m",
)  # fmt: skip
WHOLES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0x80000000)
DESCRIPTIONS = ("<f8", "|O", "<U9", "<M8[s]", "|V8", ">f4", "<c16", "[('a', '<f8')]")
SHAPES = ("()", "(0,)", "(3, 3)", "(1000000000, 1000)", "(-1, 4)", "(2, 0, 9)", "(4, 165, 1, 1)", "(True,)")


def flipped(content: bytes, rng: random.Random) -> bytes:
    """Some bits."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 3, 20))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(content: bytes, rng: random.Random) -> bytes:
    """The beginning alone."""
    return content[: rng.choice((0, 1, rng.randrange(len(content)), len(content) - 1))]


def pasted(content: bytes, rng: random.Random) -> bytes:
    """A piece left out, twice there, or exchanged."""
    start = rng.randrange(len(content))
    piece = content[start : start + rng.choice((1, 8, 100, 4000))]
    place = rng.randrange(len(content))
    return rng.choice((
        content[:start] + content[start + len(piece) :],
        content[:place] + piece + content[place:],
        content[:place] + piece + content[place + len(piece) :],
    ))  # fmt: skip


def worded(content: bytes, rng: random.Random) -> bytes:
    """With a word that harms a terminal, a path or a parser, in a text inside quotes where there is one."""
    quotes = [m.end() for m in re.finditer(rb'["\',\n=:]', content[:200_000])] or [0]
    place = rng.choice(quotes)
    return content[:place] + rng.choice(WORDS) + content[place:]


def numbered(content: bytes, rng: random.Random) -> bytes:
    """One to three numbers of a text replaced."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        found = list(re.finditer(rb"-?\d[\d.eE+-]*", content[:200_000]))
        if not found:
            return flipped(content or b"x", rng)
        one = rng.choice(found)
        content = content[: one.start()] + rng.choice(NUMBERS) + content[one.end() :]
    return content


def counted(content: bytes, rng: random.Random) -> bytes:
    """An integer of one, two, four or eight bytes that says another length."""
    size = rng.choice((1, 2, 4, 8))
    place = rng.randrange(max(1, min(len(content), rng.choice((64, 1024, len(content)))) - size + 1))
    value = rng.choice(WHOLES) & (2 ** (8 * size) - 1)
    return content[:place] + value.to_bytes(size, rng.choice(("little", "big"))) + content[place + size :]


def headed(content: bytes, rng: random.Random) -> bytes:
    """An array that says another kind or shape."""
    if not content.startswith(b"\x93NUMPY"):
        return flipped(content, rng)
    size = struct.unpack("<H", content[8:10])[0]
    old = content[10 : 10 + size].decode("latin-1")
    same = re.search(r"'descr': ('[^']*')", old)
    others = [text if text.startswith("[") else repr(text) for text in DESCRIPTIONS]
    kind = same[1] if same and rng.random() < 0.5 else rng.choice(others)
    text = f"{{'descr': {kind}, 'fortran_order': {rng.choice(('True', 'False'))}, 'shape': {rng.choice(SHAPES)}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content[10 + size :]


class _Planted:
    """Unpickled it makes a file."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch CANARY",)


def planted(content: bytes, rng: random.Random) -> bytes:
    """A pickle that runs a command: alone, in an array of objects, or before what was there."""
    protocol = rng.choice((0, 2, 4))
    code = rng.choice((
        pickle.dumps(_Planted(), protocol), pickle.dumps({"v_template": _Planted(), "f": [_Planted()]}, protocol),
        b"cos\nsystem\n(S'touch CANARY'\ntR.", b"(S'touch CANARY'\nios\nsystem\n.",
        b"c__builtin__\neval\n(S'__import__(\"os\").system(\"touch CANARY\")'\ntR.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cos\nsystem\n(S'touch CANARY'\ntRt.",
        b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x0ctouch CANARY\x85R.",
    ))  # fmt: skip
    array = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }\n"
    start = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(array)) + array
    return rng.choice((code, start + code, code[:-1] + b"0" + content))


def packed(content: bytes, rng: random.Random) -> bytes:
    """A zip with a member broken, gone, twice, or called otherwise; its checksums are right."""
    with contextlib.suppress(Exception), zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
        k = rng.randrange(len(members))
        name, data = members[k]
        change = rng.choice((*BYTES, *BYTES, "gone", "twice", "name"))
        if change == "gone":
            del members[k]
        elif change == "twice":
            members.append((name, data))
        elif change == "name":
            members[k] = (rng.choice(("../../CANARY", "/tmp/CANARY", "x\x1b[2J", name.upper(), name + "/")), data)
        else:
            members[k] = (name, change(data or b"x", rng))
        stream = io.BytesIO()
        method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
        with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(stream, "w", method) as made:
            for name, data in members:
                made.writestr(name, data)
        return stream.getvalue()
    return flipped(content or b"x", rng)


BYTES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    flipped, flipped, cut, pasted, worded, worded, numbered, numbered, numbered, counted, headed, headed, planted,
)  # fmt: skip


def broken(files: dict[str, bytes], rng: random.Random) -> dict[str, bytes]:
    """The files with one or two of them changed, or one gone; those that say most, which are small and texts, rather than pictures."""
    changed = dict(files)
    for _ in range(rng.choice((1, 1, 1, 2))):
        names = sorted(changed)
        texts = [name for name in names if not name.endswith((".jpg", ".png"))]
        name = rng.choice(texts if texts and rng.random() < 0.8 else names)
        content = changed[name] or b"x"
        if len(files) > 1 and rng.random() < 0.05:
            del changed[name]
            continue
        if content.startswith(b"PK") and rng.random() < 0.8:
            changed[name] = packed(content, rng)
        elif content.startswith(b"\x93NUMPY") and rng.random() < 0.5:
            changed[name] = headed(content, rng)
        else:
            changed[name] = rng.choice(BYTES)(content, rng)
    return changed or files


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
        if begun is None and worker.returncode > 0:
            raise RuntimeError(f"the worker has failed at file {first}")
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
