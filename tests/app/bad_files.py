"""Broken motions, avatars and sessions, each as what is wrong → a function that writes the file, and the words that refuse it."""

from __future__ import annotations

import json
import pickle
import struct
import zipfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import safetensors.torch
import torch

from avatarrex.files.assets import DATA
from avatarrex.signals.joints import EXPRESSION_NAMES

Bad = dict[str, tuple[str, Callable[[Path], object], str]]
"""What is wrong: name of the file, what writes it, a pattern of the error behind the path."""


def bvh(frames: int = 3) -> str:
    """A T-pose skeleton in centimetres, three frames, nothing moves."""
    leg = [("Leg", "0 -42 0"), ("Foot", "0 -42 0")]
    arm = [("ForeArm", "{}28 0 0"), ("Hand", "{}25 0 0")]

    def chain(side: str, sign: str, parts: list[tuple[str, str]]) -> str:
        if not parts:
            return "End Site { OFFSET 0 -5 0 }"
        (name, offset), *rest = parts
        head = f"JOINT {side}{name} {{ OFFSET {offset.format(sign)} CHANNELS 3 Zrotation Xrotation Yrotation"
        return f"{head} {chain(side, sign, rest)} }}"

    sides = (("Left", ""), ("Right", "-"))
    legs = " ".join(chain(s, g, [("UpLeg", "{}10 0 0"), *leg]) for s, g in sides)
    arms = " ".join(chain(s, g, [("Arm", "{}18 35 0"), *arm]) for s, g in sides)
    head = "JOINT Head { OFFSET 0 50 0 CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 0 9 0 } }"
    spine = f"JOINT Spine {{ OFFSET 0 12 0 CHANNELS 3 Zrotation Xrotation Yrotation {arms} {head} }}"
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    text = f"HIERARCHY ROOT Hips {{ OFFSET 0 90 0 {channels} {legs} {spine} }} MOTION"
    for word in ("ROOT", "JOINT", "End Site", "{", "}", "OFFSET", "CHANNELS", "MOTION"):
        text = text.replace(f" {word}", f"\n{word}")
    width = 3 * text.count("CHANNELS") + 3
    rows = [" ".join(["0.0"] * width)] * frames
    return "\n".join([text, f"Frames: {frames}", "Frame Time: 0.04", *rows]) + "\n"


def csv(rows: int = 3) -> str:
    """A Live Link Face recording without head angles, a neutral face."""
    header = ",".join(["Timecode", "BlendShapeCount", *EXPRESSION_NAMES])
    lines = [",".join([f"00:00:00:{k:02d}.000", "52", *["0.0"] * 52]) for k in range(rows)]
    return "\n".join([header, *lines]) + "\n"


def _text(change: Callable[[str], str], text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(change(text))


def _bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def _arrays(**arrays: object) -> Callable[[Path], object]:
    return lambda path: np.savez(path, **arrays)


def _zip(**members: bytes) -> Callable[[Path], object]:
    """A zip with `_` for the dot in its members' names."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in members.items():
                archive.writestr(name.replace("_npy", ".npy"), content)

    return write


def header(shape: str) -> bytes:
    """The head of an `.npy` file of doubles."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (53 - len(text) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _bomb(path: Path) -> None:
    """A zip whose directory says that a member unpacks to 4 GiB."""
    np.savez(path, poses=np.zeros((3, 165)))
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = struct.pack("<I", 2**32 - 2)
    path.write_bytes(content)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.write(bvh().encode())
        file.truncate(10 * 2**30)


class Payload:
    """Pickles to a call that makes a folder: what a hostile file would do with the shell."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.mkdir, (str(self.folder),)


def _pickled(path: Path) -> None:
    np.savez(path, poses=np.array([[Payload(path.parent / "executed")]], dtype=object))


B, C = bvh(), csv()
ROW = np.zeros((3, 165))
MOTIONS: Bad = {
    "nothing there": ("m.bvh", lambda path: None, "a motion file, found nothing there"),
    "a folder": ("m.npz", lambda path: path.mkdir(), "a motion file, found a folder"),
    "another kind": ("m.c3d", _text(str, "x"), r"a motion file: \.bvh, .*found \.c3d"),
    "name too long": ("m" * 300 + ".bvh", lambda path: None, "a motion file, found File name too long"),
    "under a file": ("m.bvh/m.bvh", lambda path: path.parent.write_text(""), "a motion file, found nothing there"),
    "bvh: empty": ("m.bvh", _text(str, ""), "line 1: expected HIERARCHY, found an empty file"),
    "bvh: binary": ("m.bvh", _bytes(bytes(range(256)) * 4), "line 1: expected HIERARCHY"),
    "bvh: UTF-16": ("m.bvh", _bytes(B.encode("utf-16")), "line 1: expected HIERARCHY"),
    "bvh: terminal codes": ("m.bvh", _text(str, "\x1b[31m\x07HI"), r"line 1: expected HIERARCHY, found �\[31m�HI"),
    "bvh: cut in the hierarchy": ("m.bvh", _text(lambda t: t[:300], B), "expected"),
    "bvh: cut in the motion": ("m.bvh", _text(lambda t: t[:-250], B), "expected"),
    "bvh: NaN": ("m.bvh", _text(lambda t: t.replace("0.0 0.0", "nan 0.0", 1), B), r"line \d+: expected .* finite numbers"),
    "bvh: too large": ("m.bvh", _text(lambda t: t.replace("0.0 0.0", "1e300 0.0", 1), B), r"numbers up to 1e\+09, found 1e\+300"),
    "bvh: bones too large": ("m.bvh", _text(lambda t: t.replace("0 -42 0", "0 1e308 0"), B), r"numbers up to 1e\+09"),
    "bvh: no left knee": ("m.bvh", _text(lambda t: t.replace("LeftLeg", "Tail"), B), "a joint for left_knee, found Hips"),
    "bvh: a value less": ("m.bvh", _text(lambda t: t.replace("0.0 ", "", 1), B), r"line \d+: expected \d+ finite numbers"),
    "bvh: a channel twice": (
        "m.bvh", _text(lambda t: t.replace("Zrotation Xrotation", "Zrotation Zrotation", 1), B), "each channel once"),
    "bvh: no frames": ("m.bvh", _text(lambda t: t.replace("Frames: 3", "Frames: 0"), B), "Frames: expected a whole number"),
    "bvh: half a frame": ("m.bvh", _text(lambda t: t.replace("Frames: 3", "Frames: 2.5"), B), "Frames: expected a whole"),
    "bvh: a billion frames": (
        "m.bvh", _text(lambda t: t.replace("Frames: 3", "Frames: 999999999"), B), "999999999 lines of motion, found 3"),
    "bvh: no frame time": ("m.bvh", _text(lambda t: t.replace("0.04", "0"), B), "a frame time above 0.* found 0.0"),
    "bvh: tiny frame time": ("m.bvh", _text(lambda t: t.replace("0.04", "1e-320"), B), "a frame time above 0"),
    "bvh: 10 GB": ("m.bvh", _sparse, "a BVH file of at most 512 MiB, found 10240 MiB"),
    "npz: empty": ("m.npz", _bytes(b""), "a complete .npz file, found File is not a zip file"),
    "npz: no zip": ("m.npz", _bytes(b"x" * 4000), "a complete .npz file, found File is not a zip file"),
    "npz: no arrays": ("m.npz", _zip(poses=b"hello"), r"poses: expected a plain array .*found other bytes"),
    "npz: pickled": ("m.npz", _pickled, r"poses: expected a plain array \(no pickled objects\)"),
    "npz: missing key": ("m.npz", _arrays(trans=np.zeros((3, 3))), "poses, pose_body or body_pose, found only trans"),
    "npz: wrong length": ("m.npz", _arrays(poses=ROW, trans=np.zeros((2, 3))), r"trans: expected shape \(3, 3\), found \(2, 3\)"),
    "npz: wrong width": ("m.npz", _arrays(poses=np.zeros((3, 71))), r"poses: expected shape .* found \(3, 71\)"),
    "npz: no frames": ("m.npz", _arrays(poses=ROW[:0]), "poses: expected"),
    "npz: NaN": ("m.npz", _arrays(poses=ROW * np.nan), "poses: expected finite numbers, found 495 NaN or Inf"),
    "npz: too large": ("m.npz", _arrays(poses=ROW + 1e300), r"poses: expected radians up to 1000, found 1e\+300"),
    "npz: too far": ("m.npz", _arrays(poses=ROW, trans=ROW[:, :3] + 1e30), r"trans: expected metres up to 1e\+06"),
    "npz: text": ("m.npz", _arrays(poses=ROW.astype(str)), "poses: expected numbers"),
    "npz: complex": ("m.npz", _arrays(poses=ROW + 1j), "poses: expected numbers, found complex128"),
    "npz: 0 fps": ("m.npz", _arrays(poses=ROW, fps=0), "fps: expected a rate above 0, at most 1000, found 0"),
    "npz: claims 13 GB": ("m.npz", _zip(poses_npy=header("(10000000, 165)") + bytes(80)), "poses: expected"),
    "npz: claims more than there is": ("m.npz", _zip(poses_npy=header(f"({10**30}, 165)")), "poses: expected"),
    "npz: negative shape": ("m.npz", _zip(poses_npy=header("(-3, 165)")), "poses: expected"),
    "npz: unpacks to 4 GiB": ("m.npz", _bomb, "poses: expected arrays of at most 271 MiB, found 4095 MiB"),
    "csv: empty": ("m.csv", _text(str, ""), "rows: expected a header and at least one frame, found 0"),
    "csv: a header alone": ("m.csv", _text(lambda t: t.split("\n")[0], C), "at least one frame"),
    "csv: missing column": ("m.csv", _text(lambda t: t.replace("jawOpen", "jaw"), C), "header: expected a column jawOpen"),
    "csv: cut": ("m.csv", _text(lambda t: t[:-30], C), r"line 4: expected 54 values, found \d+"),
    "csv: NaN": ("m.csv", _text(lambda t: t.replace("52,0.0", "52,nan", 1), C), "line 2: eyeBlinkLeft: expected a finite number"),
    "csv: too large": ("m.csv", _text(lambda t: t.replace("52,0.0", "52,1e30", 1), C), "line 2: eyeBlinkLeft: expected"),
    "csv: text": ("m.csv", _text(lambda t: t.replace("52,0.0", "52,open", 1), C), "eyeBlinkLeft: expected a number, found open"),
    "csv: timecode": ("m.csv", _text(lambda t: t.replace("00:00:00:01.000", "soon"), C), "line 3: Timecode: expected"),
    "json: empty": ("m.json", _text(str, ""), "a JSON file, found"),
    "json: cut": ("m.json", _text(str, '{"frames": [{"jaw_pose": [0,'), "a JSON file, found"),
    "json: nested deeply": ("m.json", _text(str, "[" * 200000), "a JSON file nested at most 64 deep, found brackets nested too deeply"),
    "json: Latin-1": ("m.json", _bytes('{"name": "é"}'.encode("latin-1")), "byte 10: expected a JSON file in UTF-8"),
    "json: NaN": ("m.json", _text(str, '{"jaw_pose": [0, 0, NaN]}'), "jaw_pose: expected finite numbers, found NaN or Inf"),
    "json: too large": ("m.json", _text(str, '{"translation": [0, 0, 1e300]}'), "translation: expected numbers up to"),
    "json: endless integer": (
        "m.json", _text(str, '{"jaw_pose": [0, 0, 1' + "0" * 400 + "]}"), "jaw_pose: expected finite numbers, found NaN or Inf"),
    "json: wrong length": ("m.json", _text(str, '{"jaw_pose": [0, 0]}'), r"jaw_pose: expected shape \(3,\), found \(2,\)"),
    "json: ragged": ("m.json", _text(str, '{"body_pose": [[0, 0, 0], [0]]}'), r"body_pose: expected numbers of shape \(21, 3\)"),
    "json: text": ("m.json", _text(str, '{"jaw_pose": ["1", "2", "3"]}'), "jaw_pose: expected numbers"),
    "json: unknown key": ("m.json", _text(str, '{"mood": 1}'), "mood: expected one of .* found an unknown field"),
    "json: no frames": ("m.json", _text(str, '{"frames": []}'), "frames: expected a list of at least one frame"),
    "json: 0 fps": ("m.json", _text(str, '{"fps": 0, "frames": [{}]}'), "fps: expected a rate above 0, at most 1000, found 0"),
    "json: newer": ("m.json", _text(str, '{"version": 2, "frames": [{}]}'), "version: expected 1, found 2"),
    "json: a null": ("m.json", _text(str, "null"), "expected an object, found NoneType"),
}  # fmt: skip


@lru_cache(maxsize=1)
def _parts() -> tuple[dict, bytes]:
    with zipfile.ZipFile(DATA / "default.avatar") as archive:
        return json.loads(archive.read("avatar.json")), archive.read("weights.safetensors")


def _avatar(path: Path, meta: object, weights: bytes | None) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        if meta is not None:
            archive.writestr("avatar.json", meta if isinstance(meta, str) else json.dumps(meta))
        if weights is not None:
            archive.writestr("weights.safetensors", weights)


def _meta(**changes: object) -> Callable[[Path], object]:
    """The default avatar with another `avatar.json` and no weights to speak of: it must be refused before they are read."""
    return lambda path: _avatar(path, {**_parts()[0], **changes}, b"")


def _weights(change: Callable[[dict[str, torch.Tensor]], object]) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        meta, weights = _parts()
        state = safetensors.torch.load(weights)
        change(state)
        _avatar(path, meta, safetensors.torch.save(state))

    return write


NAME, NODES = "face.geometry.unets.1.up.0.2.bias", "body.node_vertex"
"""A tensor of weights and one of vertices."""


def _flipped(path: Path) -> None:
    content = bytearray((DATA / "default.avatar").read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)


AVATARS: Bad = {
    "nothing there": ("a.avatar", lambda path: None, "an avatar folder or an .avatar file, found nothing there"),
    "an empty folder": ("a", lambda path: path.mkdir(), "avatar.json: expected the file to be in the avatar"),
    "a folder without weights": (
        "a", lambda path: (path.mkdir(), (path / "avatar.json").write_text("{}")),
        "weights.safetensors: expected the file to be in the avatar, found nothing there"),
    "empty": ("a.avatar", _bytes(b""), "a whole .avatar file, found File is not a zip file"),
    "a motion": ("a.bvh", _text(str, B), "a whole .avatar file, found File is not a zip file"),
    "cut": ("a.avatar", lambda path: path.write_bytes((DATA / "default.avatar").read_bytes()[:-3000]), "a whole .avatar file"),
    "a flipped byte": ("a.avatar", _flipped, "weights.safetensors: expected .* found Bad CRC-32"),
    "no weights": ("a.avatar", lambda path: _avatar(path, {}, None), "weights.safetensors: expected the file to be"),
    "no avatar.json": ("a.avatar", lambda path: _avatar(path, None, b""), "avatar.json: expected the file to be"),
    "no JSON": ("a.avatar", lambda path: _avatar(path, "{", b""), "avatar.json: expected JSON"),
    "nested deeply": ("a.avatar", lambda path: _avatar(path, "[" * 200000, b""), "avatar.json: expected JSON"),
    "a list": ("a.avatar", lambda path: _avatar(path, "[1]", b""), "avatar.json: expected an object, found list"),
    "newer format": ("a.avatar", _meta(format=99), r"avatar.json: format: expected at most \d+ \(update the studio\), found 99"),
    "format as text": ("a.avatar", _meta(format="1"), "avatar.json: format: expected an integer"),
    "unknown preset": ("a.avatar", _meta(preset="huge"), "avatar.json: preset: expected paper or compact, found huge"),
    "preset as list": ("a.avatar", _meta(preset=[1]), "avatar.json: preset: expected a text"),
    "seed as text": ("a.avatar", _meta(seed="x"), "avatar.json: seed: expected an integer, found x"),
    "endless seed": ("a.avatar", _meta(seed=10**40), "avatar.json: seed: expected"),
    "another template": ("a.avatar", _meta(person_hash="0"), "avatar.json: person_hash: expected the template"),
    "untrained parts as number": ("a.avatar", _meta(untrained=5), "avatar.json: untrained: expected a list of .* found 5"),
    "unknown part": ("a.avatar", _meta(untrained=["tail"]), "avatar.json: untrained: expected a list of"),
    "template as number": ("a.avatar", _meta(person=5), "avatar.json: person: expected a text, found 5"),
    "weights are no tensors": ("a.avatar", lambda path: _avatar(path, _parts()[0], b"x" * 99), "a safetensors file"),
    "weights cut": ("a.avatar", lambda path: _avatar(path, _parts()[0], _parts()[1][:-999]), "a safetensors file"),
    "weights claim 10 GB": (
        "a.avatar", lambda path: _avatar(path, _parts()[0], struct.pack("<Q", 10**10) + _parts()[1][8:]), "a safetensors file"),
    "NaN weights": ("a.avatar", _weights(lambda s: s[NAME].fill_(np.nan)), rf"{NAME}: expected finite numbers, found NaN or Inf"),
    "wrong shape": ("a.avatar", _weights(lambda s: s.update({NAME: s[NAME][:-1].clone()})), rf"{NAME}: expected \(32,\), found \(31,\)"),
    "missing tensor": ("a.avatar", _weights(lambda s: s.pop(NAME)), rf"{NAME}: expected a tensor \(32,\), found missing"),
    "a tensor more": ("a.avatar", _weights(lambda s: s.update(extra=torch.zeros(2))), "extra: expected no such tensor"),
    "whole numbers for weights": ("a.avatar", _weights(lambda s: s.update({NAME: s[NAME].int()})), rf"{NAME}: expected numbers as"),
    "nodes off the template": ("a.avatar", _weights(lambda s: s[NODES].add_(10**6)), rf"{NODES}: expected vertices of the template"),
    "pickled weights": (
        "a.avatar", lambda path: _avatar(path, _parts()[0], pickle.dumps(Payload(path.parent / "executed"))), "a safetensors file"),
}  # fmt: skip


def _session(**changes: object) -> Callable[[Path], object]:
    plain = {"format": 1, "kind": "session", "start": {"format": 1}, "steps": []}
    return lambda path: path.write_text(json.dumps({**plain, **changes}))


def _step(**command: object) -> Callable[[Path], object]:
    return _session(steps=[[command]])


SESSIONS: Bad = {
    "nothing there": ("s.json", lambda path: None, "a session file, found nothing there"),
    "a folder": ("s.json", lambda path: path.mkdir(), "a session file, found a folder"),
    "empty": ("s.json", _text(str, ""), "a session file, found"),
    "cut": ("s.json", _text(str, '{"format": 1, "kind"'), "a session file, found"),
    "nested deeply": ("s.json", _text(str, "[" * 200000), "a session file nested at most 64 deep, found brackets nested too deeply"),
    "another file": ("s.json", _text(str, '{"fps": 30}'), "kind: expected a session of the studio"),
    "newer": ("s.json", _session(format=9), r"format: expected at most 1 \(update the studio\), found 9"),
    "no start": ("s.json", _session(start=None), "start: expected an object, found NoneType"),
    "unknown field": ("s.json", _session(start={"format": 1, "mood": 1}), "start: mood: expected one of"),
    "one side": ("s.json", _session(start={"format": 1, "size": {"fixed": [16]}}), "start: .*(a width and a height|a state of the studio)"),
    "steps are numbers": ("s.json", _session(steps=[5]), r"steps\[0\]: expected a list of commands, found int"),
    "no command": ("s.json", _step(command="Dance"), "command: expected the name of a command, found Dance"),
    "no such joint": ("s.json", _step(command="SetJoint", joint="tail", rotation=[0, 0, 0]), r"steps\[0\]: joint: expected"),
    "NaN": ("s.json", _step(command="SetJoint", joint="jaw", rotation=[0, 0, np.nan]), "jaw_pose: expected finite numbers"),
    "zoom by NaN": ("s.json", _step(command="ZoomBy", factor=np.nan), r"steps\[0\]: camera: distance: expected a number"),
    "orbit by nothing": (
        "s.json", _step(command="OrbitBy", azimuth=None, elevation=0), "(values of the right kind|the fields of that command)"),
    "a frame before the first": ("s.json", _step(command="SetFrame", frame=-1, signals={}), "frame: expected 0 or more, found -1"),
    "a layer of no kind": (
        "s.json", _step(command="AddLayer", layer={"name": "a", "clip": 3}), "(values of the right kind|the fields of that command)"),
    "keys of no layer": ("s.json", _step(command="DeleteKeys", name="a", places=[]), "a layer to be added first"),
    "a key at no time": (
        "s.json", _step(command="AddLayer", layer={"name": "a", "tracks": [{"name": "jawOpen", "keys": [["x", [1], "linear"]]}]}),
        "finite numbers"),
}  # fmt: skip
