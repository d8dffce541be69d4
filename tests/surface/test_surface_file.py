"""The surface's file: what goes in comes out, and each thing that can be wrong in it is refused by file and field."""

from __future__ import annotations

import io
import json
import logging
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from PIL import Image
from surface.template_surface import template_surface

from avatarrex.avatar_file import SURFACE, load_avatar, save_avatar, store_surface
from avatarrex.errors import InputError
from avatarrex.files.assets import DATA
from avatarrex.surface.surface import Correction, Surface
from avatarrex.surface.surface_file import FILE, KINDS, LARGEST, MOST_SIDE, read_surface, surface_bytes, weights_key

Arrays = dict[str, np.ndarray]
TEMPLATE_FACES = int(template_surface().template_face.max()) + 1
FLOATS = ("vertices", "weight", "barycentric", "uv", "lit", "morph", "morph_colour", "correction.poses",
          "correction.closeness", "correction.weights", "correction.low", "correction.high", "correction.basis")  # fmt: skip


@pytest.fixture(scope="module")
def surface() -> Surface:
    return replace(template_surface(0.01), key="0123456789abcdef", meta={"seconds": 1.5, "poses": 6})


def packed(surface: Surface, change: Callable[[Arrays], object] | None = None, **about: object) -> bytes:
    """The file's bytes with arrays changed, or fields of the description."""
    content = surface_bytes(surface)
    arrays = safetensors.numpy.load(content)
    length = int.from_bytes(content[:8], "little")
    text = json.loads(content[8 : 8 + length])["__metadata__"]["surface"]
    if change is not None:
        change(arrays)
    return safetensors.numpy.save(
        {name: np.ascontiguousarray(value) for name, value in arrays.items()},
        {"surface": json.dumps({**json.loads(text), **about})},
    )


def jpeg(width: int, height: int, form: str = "JPEG") -> np.ndarray:
    """A picture of one colour as bytes."""
    out = io.BytesIO()
    Image.new("L", (width, height)).save(out, form)
    return np.frombuffer(out.getvalue(), np.uint8)


def claimed(width: int, height: int) -> np.ndarray:
    """A small JPEG whose header claims another size."""
    content = bytearray(jpeg(8, 8).tobytes())
    place = content.index(b"\xff\xc0") + 5
    content[place : place + 4] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    return np.frombuffer(bytes(content), np.uint8)


def test_round_trip(surface: Surface) -> None:
    again = read_surface(surface_bytes(surface), "a", TEMPLATE_FACES)
    pairs = [(item.name, surface, again) for item in fields(Surface)]
    pairs += [(item.name, surface.correction, again.correction) for item in fields(Correction)]
    for name, before, after in pairs:
        value, found = getattr(before, name), getattr(after, name)
        if not isinstance(value, np.ndarray):
            assert name == "correction" or value == found
            continue
        assert (value.dtype, value.shape) == (found.dtype, found.shape), name
        near = {"albedo": 6}.get(name, 1e-3 if value.dtype == np.float32 else 0)
        assert np.abs(value.astype(float) - found.astype(float)).max() <= near, name
    assert np.array_equal(again.vertices, surface.vertices), "whole precision"


def set_to(name: str, value: object) -> Callable[[Arrays], object]:
    return lambda arrays: arrays.update({name: value})


def cut(name: str) -> Callable[[Arrays], object]:
    return lambda arrays: arrays.update({name: arrays[name][..., :-1]})


def spoiled(name: str, number: float) -> Callable[[Arrays], object]:
    def change(arrays: Arrays) -> None:
        value = arrays[name].copy()
        value.reshape(-1)[-1] = number
        arrays[name] = value

    return change


@pytest.mark.parametrize("name", [*KINDS, *FLOATS])
def test_each_array_is_needed_and_of_its_kind(name: str, surface: Surface) -> None:
    for change, expected in (
        (lambda arrays: arrays.pop(name), "expected the arrays of a surface, found missing"),
        (set_to(name, np.zeros(3, np.int64)), "expected numbers as"),
        (set_to(name, np.zeros((2, 2, 2, 2), KINDS.get(name, np.float32))), "expected"),
    ):
        with pytest.raises(InputError, match=expected):
            read_surface(packed(surface, change), "a.avatar", TEMPLATE_FACES)


@pytest.mark.parametrize("name", [name for name in (*KINDS, *FLOATS) if name != "albedo"])
def test_each_shape_fits_the_others(name: str, surface: Surface) -> None:
    with pytest.raises(InputError, match=rf"^a\.avatar: {FILE}: \S+: expected shape") as refused:
        read_surface(packed(surface, cut(name)), "a.avatar", TEMPLATE_FACES)
    assert name in str(refused.value) or name in ("morph_vertex", "correction.joints", "uv_vertex", "part")


@pytest.mark.parametrize("name", FLOATS)
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_are_finite(name: str, number: float, surface: Surface) -> None:
    with pytest.raises(InputError, match=f"{FILE}: {name}: expected finite numbers, found NaN or Inf"):
        read_surface(packed(surface, spoiled(name, number)), "a.avatar", TEMPLATE_FACES)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        *((name, -1) for name in ("faces", "template_face", "uv_vertex", "uv_faces", "morph_vertex")),
        *((name, 10**6) for name in ("faces", "template_face", "uv_vertex", "uv_faces", "morph_vertex")),
        ("joint", 55), ("part", 4), ("correction.group", 55), ("correction.joints", -2), ("correction.joints", 55),
    ],
)  # fmt: skip
def test_indices_are_of_something(name: str, number: int, surface: Surface) -> None:
    with pytest.raises(InputError, match=f"{FILE}: {name}: expected indices from .* found {number}$"):
        read_surface(packed(surface, spoiled(name, number)), "a.avatar", TEMPLATE_FACES)


def test_the_textures_mesh_is_the_mesh(surface: Surface) -> None:
    with pytest.raises(InputError, match="uv_faces: expected the faces of the mesh"):
        read_surface(packed(surface, spoiled("uv_faces", 0)), "a.avatar", TEMPLATE_FACES)


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.zeros(100, np.uint8), "a JPEG image"),
        (jpeg(8, 8, "PNG"), "a JPEG image"),
        (jpeg(8, 8)[:60], "a JPEG image"),
        (claimed(MOST_SIDE + 1, 8), f"at most {MOST_SIDE} texels a side"),
        (claimed(10_000, 10_000), "a JPEG image"),
        (claimed(65_000, 65_000), "a JPEG image"),
    ],
)
def test_pictures_that_are_none_or_huge(image: np.ndarray, expected: str, surface: Surface) -> None:
    with pytest.raises(InputError, match=f"albedo: expected {expected}"):
        read_surface(packed(surface, set_to("albedo", image)), "a.avatar", TEMPLATE_FACES)


@pytest.mark.parametrize(
    ("about", "expected"),
    [
        ({"albedo_scale": 0}, "albedo_scale: expected a number"),
        ({"albedo_scale": "1"}, "albedo_scale: expected a number"),
        ({"albedo_scale": None}, "albedo_scale: expected a number"),
        ({"meta": [1]}, "meta: expected an object, found list"),
        ({"meta": json.loads("[" * 90 + "]" * 90)}, "nested at most 64 deep"),
    ],
)
def test_descriptions_that_are_wrong(about: dict[str, object], expected: str, surface: Surface) -> None:
    with pytest.raises(InputError, match=expected):
        read_surface(packed(surface, None, **about), "a.avatar", TEMPLATE_FACES)


@pytest.mark.parametrize("length", [0, 7, 8, 100, -1])
def test_what_is_cut_off(length: int, surface: Surface) -> None:
    with pytest.raises(InputError, match="a safetensors file of a surface"):
        read_surface(surface_bytes(surface)[:length], "a.avatar", TEMPLATE_FACES)


@pytest.fixture(scope="module")
def fitting(surface: Surface) -> Surface:
    """Of the packaged avatar's weights, by its key."""
    return replace(surface, key=weights_key(load_avatar("default")))


@pytest.mark.parametrize("name", ["copy.avatar", "folder"])
def test_an_avatar_keeps_its_surface(name: str, fitting: Surface, tmp_path: Path, caplog) -> None:
    avatar = load_avatar("default")
    avatar.surface = fitting
    save_avatar(avatar, tmp_path / name)
    again = load_avatar(tmp_path / name)
    assert again.surface is not None
    assert np.array_equal(again.surface.faces, fitting.faces)
    assert (again.surface.key, again.surface.meta) == (fitting.key, fitting.meta)
    assert not caplog.records
    assert again.frozen_copy().surface is None
    if name == "copy.avatar":
        with zipfile.ZipFile(tmp_path / name) as archive:
            assert archive.getinfo(SURFACE).compress_type == zipfile.ZIP_DEFLATED


@pytest.mark.parametrize("name", ["copy.avatar", "folder"])
def test_other_weights_do_not_keep_it(name: str, fitting: Surface, tmp_path: Path) -> None:
    """Neither when they are saved with it, nor over an avatar that had one."""
    avatar = load_avatar("default")
    avatar.surface = fitting
    save_avatar(avatar, tmp_path / name)
    avatar.tone.state_dict()[next(iter(avatar.tone.state_dict()))].add_(1)
    save_avatar(avatar, tmp_path / name)
    assert load_avatar(tmp_path / name).surface is None
    if name == "folder":
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == ["avatar.json", "weights.safetensors"]


def folder_with(tmp_path: Path, content: bytes) -> Path:
    with zipfile.ZipFile(DATA / "default.avatar") as archive:
        archive.extractall(tmp_path / "me", ["avatar.json", "weights.safetensors"])
    (tmp_path / "me" / SURFACE).write_bytes(content)
    return tmp_path / "me"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (lambda surface: surface_bytes(surface), "surface.safetensors: key: expected that of these weights"),
        (lambda surface: b"not tensors", "expected a safetensors file of a surface"),
        (lambda surface: packed(surface, spoiled("faces", -1)), "surface.safetensors: faces: expected indices"),
    ],
)
def test_an_avatar_with_a_stale_or_broken_one_loads_and_says_so(content, said, surface, tmp_path, caplog) -> None:
    path = folder_with(tmp_path, content(surface))
    zipped = tmp_path / "me.avatar"
    with zipfile.ZipFile(zipped, "w") as archive:
        for file in path.iterdir():
            archive.write(file, file.name)
    for source in (path, zipped):
        caplog.clear()
        assert load_avatar(source).surface is None
        (record,) = caplog.records
        assert record.levelno == logging.WARNING
        assert said in record.getMessage()
        assert str(source) in record.getMessage()
        assert record.getMessage().endswith(f"`avatarrex-studio distil {source}` makes it anew")
        assert record.getMessage().isprintable()


def test_a_bomb_is_not_unpacked(tmp_path: Path, caplog) -> None:
    """A surface of zeros without end, and a sparse one on the disk."""
    path = tmp_path / "b.avatar"
    with zipfile.ZipFile(DATA / "default.avatar") as source, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name in ("avatar.json", "weights.safetensors"):
            out.writestr(name, source.read(name))
        with out.open(SURFACE, "w", force_zip64=True) as file:
            for _ in range(LARGEST // 2**20 + 1):
                file.write(bytes(2**20))
    folder = folder_with(tmp_path, b"")
    with open(folder / SURFACE, "wb") as file:
        file.truncate(20 * 10**9)
    for place in (path, folder):
        caplog.clear()
        assert load_avatar(place).surface is None
        assert f"{SURFACE}: expected a file of at most {LARGEST >> 20} MiB" in caplog.text


@pytest.mark.parametrize("name", ["copy.avatar", "folder"])
def test_a_surface_is_stored_beside_weights_as_they_were(name: str, fitting: Surface, tmp_path: Path) -> None:
    """In a folder in whole precision, which a saved avatar would lose."""
    avatar = load_avatar("default")
    save_avatar(avatar, tmp_path / name, half=name != "folder")

    def weights(path: Path) -> bytes:
        if path.is_dir():
            return (path / "weights.safetensors").read_bytes()
        with zipfile.ZipFile(path) as archive:
            return archive.read("weights.safetensors")

    before = weights(tmp_path / name)
    store_surface(tmp_path / name, fitting)
    assert weights(tmp_path / name) == before
    assert load_avatar(tmp_path / name).surface is not None
    for target in ("other.avatar", "other"):
        store_surface(tmp_path / name, fitting, tmp_path / target)
        assert weights(tmp_path / target) == before
        assert load_avatar(tmp_path / target).surface is not None


def test_a_byte_that_changed_is_found(surface: Surface) -> None:
    content = bytearray(surface_bytes(surface))
    place = content.rindex(surface.uv.tobytes()[:16])
    content[place] ^= 1
    with pytest.raises(InputError, match="expected the arrays that were written, found others"):
        read_surface(bytes(content), "a")


def test_weights_sum_to_one(surface: Surface) -> None:
    with pytest.raises(InputError, match="weight: expected rows that sum to one, found 0"):
        read_surface(packed(surface, lambda arrays: arrays["weight"].fill(0)), "a")
