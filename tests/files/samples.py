"""A sound sample of every kind of file that is read, small, with what reads it: what tools/fuzz_loaders.py breaks."""

from __future__ import annotations

import io
import json
import shutil
import tempfile
import wave
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bad_files
import filmed
import foreign
import numpy as np
import official_files
from avatarrex_studio.cli.inspect import describe
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.preferences import read_preferences
from person_files import write_person
from PIL import Image
from python2_pickles import python2_pickle

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.capture.importers.calibrations import find_cameras, read_cameras
from avatarrex.capture.importers.detections import BODY_25, read_detections
from avatarrex.capture.importers.layouts import read_source
from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.rigs import open_capture
from avatarrex.files.assets import DATA
from avatarrex.files.images import read_pixels
from avatarrex.files.sound import read_sound
from avatarrex.signals.expression_map import read_expression_map
from avatarrex.signals.hand_landmarks import rest_landmarks
from avatarrex.signals.import_options import ImportOptions
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import import_motion
from avatarrex.templates.official.correspondence import read_hand_ids, read_head_ids
from avatarrex.templates.official.expression_matrix import read_matrix
from avatarrex.templates.official.faceverse import read_faceverse, read_fifty_two
from avatarrex.templates.official.flame import read_flame
from avatarrex.templates.official.mano import read_hand
from avatarrex.templates.official.smplx import read_smplx
from avatarrex.templates.person import load_person
from avatarrex.training.runs.folder import read_about

BEFORE = Path(__file__).parents[1] / "compatibility"


@dataclass(frozen=True)
class Sample:
    """Files by name, one of which or a folder is read."""

    kind: str
    files: dict[str, bytes]
    read: Callable[[Path], object]
    """What the studio does with it; what it returns are texts that it would print, or anything."""
    entry: str = ""
    """The file that is read; empty: the folder."""
    weight: int = 4
    """How often it is broken: those that take long less."""


def samples() -> list[Sample]:
    """All, made anew."""
    return [*motions(), *models(), *captures(), *studio(), *pictures()]


def motions() -> list[Sample]:
    """By `read_motion`, through `inspect`."""
    poses = np.linspace(-0.2, 0.2, 4 * 165).reshape(4, 165)
    amass = {"poses": poses, "trans": poses[:, :3], "betas": poses[0, :10], "mocap_framerate": np.array(30.0)}
    asf = ":root\norder TX TY TZ RX RY RZ\naxis XYZ\n" + BONES
    ours = next(iter(sorted((DATA / "motions").glob("*.json"))), None)
    found = [
        ("bvh", {"m.bvh": bad_files.bvh().encode()}),
        ("live link", {"m.csv": bad_files.csv().encode()}),
        ("amass", {"m.npz": npz(amass)}),
        ("vectors", {"m.npy": npy(np.zeros((4, 322)))}),
        ("asf", {"m.amc": b":FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0 0 0 0\na 3\n", "m.asf": asf.encode()}),
        ("motion", {"m.json": b'{"format": 1, "fps": 30, "frames": [{"body_pose": {"left_knee": [0.2, 0, 0]}}, {}]}'}),
        ("speech", {"m.wav": wav()}),
        *([("own motion", {"m.json": ours.read_bytes()})] if ours else []),
    ]
    return [*(Sample(kind, files, told, next(iter(files))) for kind, files in found), *hands_and_faces()]


def hands_and_faces() -> list[Sample]:
    """Motions that need to be told what they are of, and tables of expressions."""
    fingers = {
        "poses": np.linspace(-0.2, 0.2, 4 * 48).reshape(4, 48),
        "is_right": np.array(True),
        "fps": np.array(30.0),
    }
    track = np.repeat(rest_landmarks("left")[None], 4, 0).round(4)
    landmarks = {"landmarks": track.tolist(), "hand": "left", "fps": 30}
    table = "name,0,1,2,bias\njawOpen,0.5,0,0,0\nmouthSmileLeft,0,-0.25,0,0.1\n"
    hand = partial(motion_told, ImportOptions(side="left", hand_mean="flat"))
    return [
        Sample("mano motion", {"m.npz": npz(fingers)}, partial(motion_told, ImportOptions(hand_mean="flat")), "m.npz"),
        Sample("mano pickle", {"m.pkl": python2_pickle({"pose": fingers["poses"], "fps": 30})}, hand, "m.pkl"),
        Sample("hand landmarks", {"m.json": json.dumps(landmarks).encode()}, told, "m.json"),
        Sample("hand track", {"m.npy": npy(track)}, hand, "m.npy"),
        Sample("faceverse motion", {"m.npy": npy(np.full((4, 490), 0.1))}, told, "m.npy"),
        Sample("talkshow", {"m.npy": npy(np.zeros((4, 265)))}, told, "m.npy"),
        Sample("expression map", {"m.csv": table.encode()}, lambda path: read_expression_map(path, 3), "m.csv"),
    ]


BONES = ":bonedata\nbegin\nid 1\nname a\ndirection 0 1 0\nlength 1\naxis 0 0 0 XYZ\ndof rx\nend\n:hierarchy\nbegin\nroot a\nend\n"


def models() -> list[Sample]:
    """Published models."""
    face, _ = official_files.faceverse(1, 1.0, (1, 1, 1))
    small = {key: value for key, value in official_files.smplx(20).items() if key != "posedirs"}
    hands = {f"{side}_hand": np.arange(778) for side in ("left", "right")}
    table = ",".join(EXPRESSION_NAMES) + "\n" + "\n".join(",".join("0.5" for _ in range(52)) for _ in range(4))
    with tempfile.TemporaryDirectory() as folder:
        mano = official_files.write_chumpy(Path(folder) / "m.pkl", official_files.mano("left")).read_bytes()
        old = official_files.write_chumpy(Path(folder) / "o.pkl", official_files.mano("right"), 0).read_bytes()
        fields = official_files.flame()
        fields = {**fields, "shapedirs": fields["shapedirs"][..., :20]}
        flame = official_files.write_chumpy(Path(folder) / "f.pkl", fields).read_bytes()
        verse = official_files.write_faceverse(Path(folder) / "f.npy", face).read_bytes()
        smplx = official_files.write_smplx(Path(folder) / "s.npz", small).read_bytes()
        pickled = official_files.write_smplx(Path(folder) / "s.pkl", small).read_bytes()
    whole = written(lambda out: write_person(out / "models"))
    return [
        Sample("mano", {"MANO_LEFT.pkl": mano}, lambda path: read_hand(path, "left"), "MANO_LEFT.pkl"),
        Sample("mano, protocol 0", {"MANO_RIGHT.pkl": old}, lambda path: read_hand(path, "right"), "MANO_RIGHT.pkl", 2),
        Sample("flame", {"generic_model.pkl": flame}, read_flame, "generic_model.pkl", 1),
        Sample("faceverse", {"faceverse_v1.npy": verse}, read_faceverse, "faceverse_v1.npy"),
        Sample("smplx", {"SMPLX_NEUTRAL.npz": smplx}, read_smplx, "SMPLX_NEUTRAL.npz", 1),
        Sample("smplx pickle", {"SMPLX_NEUTRAL.pkl": pickled}, read_smplx, "SMPLX_NEUTRAL.pkl", 1),
        Sample("models", whole, load_person, "models", 1),
        Sample("hand ids", {"ids.pkl": python2_pickle(hands)}, read_hand_ids, "ids.pkl"),
        Sample("head ids", {"ids.npy": npy(np.arange(5023))}, read_head_ids, "ids.npy"),
        Sample("fifty-two", {"exBase_52.npy": npy(np.zeros((30, 52)))}, read_fifty_two, "exBase_52.npy"),
        Sample("matrix", {"m.csv": table.encode()}, read_matrix, "m.csv"),
        Sample("person", {"person.npz": (DATA / "person.npz").read_bytes()}, load_person, "person.npz", 1),
    ]


def captures() -> list[Sample]:
    """Ours, those of others, and what a person who films has."""
    with zipfile.ZipFile(BEFORE / "capture.zip") as archive:
        own = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    scene, heads = foreign.scene(1), foreign.heads()
    found = [
        Sample("capture", own, capture_told),
        Sample("capture zip", {"c.zip": (BEFORE / "capture.zip").read_bytes()}, capture_told, "c.zip"),
    ]
    for name, one in (
        ("avatarrex", scene),
        ("thuman", scene),
        ("zju", scene),
        ("actorshq", scene),
        ("imavatar", heads),
        ("nerface", heads),
    ):
        files = written(lambda out, name=name, one=one: getattr(foreign, f"written_{name}")(one, out))
        found.append(Sample(name, files, lambda folder: read_source(Archive(folder))))
    rig = {"a": Camera.orbit(0, 0, 3, 40, (0, 1, 0), 64, 48), "b": Camera.orbit(90, 0, 3, 40, (0, 1, 0), 64, 48)}
    lenses = tuple(Lens(name, camera, np.zeros(5)) for name, camera in rig.items())
    person = {
        "pose_keypoints_2d": [1.0] * 3 * len(BODY_25),
        "hand_left_keypoints_2d": [],
        "hand_right_keypoints_2d": [],
    }
    openpose = repr({"version": 1.3, "people": [person]}).replace("'", '"').encode()
    points = {f"{name}/{k:012d}_keypoints.json": openpose for name in rig for k in range(2)}
    found.append(Sample("keypoints", points, lambda folder: read_detections(folder, lenses)))
    found.append(Sample("toml", {"c.toml": filmed.toml(rig).encode()}, read_cameras, "c.toml"))
    for name, made in (("opencv", filmed.easymocap(rig)), ("colmap", filmed.colmap(rig))):
        found.append(Sample(name, {key: text.encode() for key, text in made.items()}, find_cameras))
    return found


def studio() -> list[Sample]:
    """What the studio itself writes."""
    with zipfile.ZipFile(DATA / "default.avatar") as archive:
        avatar = {name: archive.read(name) for name in archive.namelist()}
    run = written(lambda out: shutil.copytree(BEFORE / "run", out, dirs_exist_ok=True))
    return [
        Sample("session", {"s.studio.json": (BEFORE / "session.json").read_bytes()}, Journal.load, "s.studio.json"),
        Sample("avatar", avatar, load_avatar, weight=1),
        Sample("run", run, read_about),
        Sample("run told", run, told),
        Sample("preferences", {"p.json": b'{"format": 1, "scale": 1.0}'}, read_preferences, "p.json"),
    ]


def pictures() -> list[Sample]:
    """And sound."""
    pixels = np.uint8(np.arange(24 * 32 * 3).reshape(24, 32, 3) % 251)
    made = {f"p.{kind}": encoded(pixels, kind) for kind in ("png", "jpg", "webp", "bmp", "tiff", "gif")}
    return [
        *(Sample(f"picture {name[2:]}", {name: data}, read_pixels, name) for name, data in made.items()),
        Sample("picture told", {"p.png": made["p.png"]}, told, "p.png"),
        Sample("sound", {"s.wav": wav()}, read_sound, "s.wav"),
    ]


def told(path: Path) -> list[str]:
    """`inspect`."""
    return describe(str(path))


def motion_told(options: ImportOptions, path: Path) -> tuple[str, ...]:
    """What is said of a motion that is read with options."""
    read = import_motion(path, options)
    return (*read.sequence.notes, *read.warnings)


def capture_told(path: Path) -> tuple[str, ...]:
    """What is said of a capture whose every first picture is read."""
    found = open_capture(path)
    for rig in found.rigs.values():
        for view in range(len(rig.views)):
            for frame in range(rig.frames):
                if rig.available(view, frame):
                    rig.image(view, frame)
                    rig.matte(view, frame)
    return found.notes


def written(write: Callable[[Path], object]) -> dict[str, bytes]:
    """What a function writes into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(Path(folder).rglob("*"))
            if path.is_file()
        }


def npz(arrays: dict[str, np.ndarray]) -> bytes:
    """As `np.savez_compressed` writes them."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    """As `np.save` writes it."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def encoded(pixels: np.ndarray, kind: str) -> bytes:
    """A picture."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, {"jpg": "jpeg"}.get(kind, kind))
    return stream.getvalue()


def wav() -> bytes:
    """A second of a tone."""
    stream = io.BytesIO()
    with wave.open(stream, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes((3000 * np.sin(np.arange(8000) / 8)).astype("<i2").tobytes())
    return stream.getvalue()
