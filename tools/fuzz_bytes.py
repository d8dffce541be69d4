"""Ways to break a file that the fuzzer has (fuzz_loaders.py): bytes, texts and numbers, members of zips, headers of arrays, planted code."""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import random
import re
import struct
import warnings
import zipfile
from collections.abc import Callable
from typing import Any

NUMBERS = (
    b"nan", b"inf", b"-1", b"1e999", b"1" + b"0" * 400, b"0", b"99999999999", b"-0.0", b"true", b"null", b'""', b"[]", b"{}", b'"\x1b[2J"',
    b"1e38", b"2147483648", b"18446744073709551616", b"0x10", b"[[[[]]]]", b"1e-320",
)  # fmt: skip
WORDS = (
    b"\x1b]0;owned\x07", b"\x00", b"\r\n", b"\xff\xfe", b"../" * 8, b"\xe2\x80\xae", b"A" * 5000, b"A" * 140_000,
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
