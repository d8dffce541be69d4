"""OpenEXR layers: linear premultiplied colour and named channels, as two other readers see them."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.files.exr import linear_premultiplied, write_exr


def test_colours_become_linear_and_stay_premultiplied():
    grey, alpha = 0.5, 0.25
    colour, found = linear_premultiplied(np.array([[[grey * alpha] * 3 + [alpha], [0, 0, 0, 0]]]))
    assert colour[0, 0] == pytest.approx([0.21404 * alpha] * 3, abs=1e-5)  # sRGB 0.5 is linear 0.21404
    assert found.tolist() == [[alpha, 0]]
    assert not colour[0, 1].any()


def test_layers_are_read_by_others(tmp_path):
    library = pytest.importorskip("OpenEXR")
    random = np.random.default_rng(1)
    image = random.uniform(0.2, 0.8, (6, 10, 4))
    image[..., :3] *= image[..., 3:]
    depth, normal = random.uniform(1, 5, (6, 10)), random.standard_normal((6, 10, 3))
    write_exr(tmp_path / "a.exr", image, {"Z": depth, "N": normal}, {"avatarrex": "{}"})
    with library.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        planes = {name: channel.pixels for name, channel in file.channels().items()}
        assert file.header()["avatarrex"] == "{}"
    assert sorted(planes) == ["A", "B", "G", "N.X", "N.Y", "N.Z", "R", "Z"]
    assert np.array_equal(planes["Z"], depth.astype(np.float32))
    assert np.array_equal(planes["N.Y"], normal[..., 1].astype(np.float32))
    colour, _ = linear_premultiplied(image)
    assert np.abs(planes["G"] - colour[..., 1]).max() < 1e-3
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "a.exr")) as other:
        seen = next(other.decode(video=0))
    assert (seen.width, seen.height) == (10, 6)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_without_the_library_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"avatarrex-studio\[exr\]"):
        write_exr(tmp_path / "a.exr", np.zeros((2, 2, 4)), {})
