"""A figure over a stage."""

import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.files.images import composite
from avatarrex.stage import picture
from avatarrex.stage.composite import backdrop, staged
from avatarrex.stage.stage import COLOUR, PICTURE, Stage
from avatarrex.surface.floor import KEY, FloorLight

SIZE = 48
VIEW = Camera.orbit(20, 30, 3, 40, (0, 0, 0), SIZE, SIZE)
GREY = (0.5, 0.5, 0.5, 1.0)
CLEAR = (0.0, 0.0, 0.0, 0.0)
NOBODY = torch.zeros(SIZE, SIZE, 4)
PLAIN = Stage(shown=True, floor=False, backdrop=COLOUR)


def spot() -> FloorLight:
    """A floor on which no key light falls within half a metre of the origin."""
    x, z = np.meshgrid(np.linspace(-2, 2, 64), np.linspace(-2, 2, 64))
    values = np.full((64, 64, 2), 255, np.uint8)
    values[..., 0] = np.where(x**2 + z**2 < 0.25, 0, 255)
    return FloorLight((-2.0, -2.0, 2.0, 2.0), values)


def test_a_stage_of_nothing_is_the_picture_over_its_background():
    image = torch.rand(SIZE, SIZE, 4, generator=torch.Generator().manual_seed(0))
    image[..., :3] *= image[..., 3:]
    assert np.array_equal(staged(image, VIEW, PLAIN, GREY, None, (0, 0)), composite(image, GREY))


def test_a_shadow_lies_where_the_floor_is_seen():
    """The origin is in the middle of the picture."""
    stage = replace(PLAIN, floor=True, height=0.0, shadow=0.8)
    shown = staged(NOBODY, VIEW, stage, GREY, spot(), (50.0, 0.0))
    assert shown[SIZE // 2, SIZE // 2, 0] == pytest.approx(255 * 0.5 * (1 - 0.8 * KEY), abs=1)
    assert shown[2, 2, 0] == 128
    assert shown[SIZE // 2, SIZE // 2 + 14, 0] == 128
    above = staged(NOBODY, Camera.orbit(20, -30, 3, 40, (0, 0, 0), SIZE, SIZE), stage, GREY, spot(), (50.0, 0.0))
    assert (above[..., 0] == 128).all(), "from below there is no floor"
    level = staged(NOBODY, Camera.orbit(0, 0, 0.5, 90, (0, -1, 0), SIZE, SIZE), stage, GREY, spot(), (0.0, 0.0))
    assert (level[..., 0] == 128).all(), "nor behind who looks down from there"


def test_a_shadow_lies_over_nothing_too():
    stage = replace(PLAIN, floor=True, height=0.0, shadow=1.0)
    shown = staged(NOBODY, VIEW, stage, CLEAR, spot(), (0.0, 0.0))
    assert shown[SIZE // 2, SIZE // 2].tolist() == [0, 0, 0, round(255 * KEY)]
    assert shown[2, 2, 3] == 0


def test_the_floor_is_brighter_about_the_figure():
    stage = replace(PLAIN, floor=True, height=0.0)
    shown = staged(NOBODY, VIEW, stage, GREY, None, (0.0, 0.0))
    assert shown[SIZE // 2, SIZE // 2, 0] > 140 > shown[0, 0, 0] >= 128


def test_a_stop_of_exposure():
    """Half as much light is 2^(−1/2.2) of an encoded colour."""
    dark = staged(NOBODY, VIEW, replace(PLAIN, exposure=-1.0), GREY, None, (0, 0))
    assert dark[0, 0].tolist() == [round(127.5 * 2 ** (-1 / 2.2))] * 3 + [255]
    assert staged(NOBODY, VIEW, replace(PLAIN, exposure=4.0), GREY, None, (0, 0))[0, 0, 0] == 255


def test_the_gradient_runs_downwards_and_a_picture_fills_the_raster(tmp_path):
    shades = backdrop(Stage(top=(0.0, 0.2, 0.0), bottom=(1.0, 0.2, 0.0)), GREY, (3, 4))
    assert shades[:, 0, 0].tolist() == [0.125, 0.375, 0.625, 0.875]
    assert (shades[..., 3] == 1).all()
    pixels = np.zeros((10, 40, 3), np.uint8)
    pixels[:, 15:25] = 200
    Image.fromarray(pixels).save(tmp_path / "wide.png")
    shown = backdrop(Stage(backdrop=PICTURE, picture=str(tmp_path / "wide.png")), GREY, (20, 20))
    assert shown.shape == (20, 20, 4)
    assert shown[10, 10, 0] == pytest.approx(200 / 255, abs=0.01)
    assert shown[..., :3].mean() > 190 / 255, "its middle alone is seen"


def test_a_picture_is_read_once_as_long_as_its_file_stays(tmp_path, monkeypatch):
    read = []
    true = picture.read_pixels
    monkeypatch.setattr(picture, "read_pixels", lambda path: (read.append(path), true(path))[1])
    path = tmp_path / "a.png"
    stage = Stage(shown=True, backdrop=PICTURE, picture=str(path))
    for value, stamp in ((50, 1_000), (200, 2_000)):
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(path)
        os.utime(path, ns=(stamp, stamp))
        for _ in range(3):
            assert backdrop(stage, GREY, (4, 4))[..., 0].mean() == pytest.approx(value / 255)
    assert len(read) == 2
    path.unlink()
    with pytest.raises(InputError, match=r"a\.png"):
        picture.check_picture(stage)
    picture.check_picture(replace(stage, shown=False))


def test_a_phone_s_picture_stands_upright_and_a_huge_one_is_made_smaller(tmp_path):
    lying = np.zeros((10, 30, 3), np.uint8)
    lying[:, :15] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # turned clockwise by a quarter to be upright
    Image.fromarray(lying).save(tmp_path / "phone.jpg", exif=exif)
    upright = picture.read_picture(picture.stamp(str(tmp_path / "phone.jpg")))
    assert upright.shape == (30, 10, 3)
    assert upright[:10].mean() > 240 > 10 > upright[-10:].mean()
    Image.fromarray(np.zeros((6, 9000, 3), np.uint8)).save(tmp_path / "wide.png")
    assert picture.read_picture(picture.stamp(str(tmp_path / "wide.png"))).shape[1] == picture.MOST_SIDE


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("elevation", 5.0), ("softness", 0.0), ("shadow", 1.5), ("exposure", float("nan")), ("backdrop", "sky"),
        ("top", (1.0, 2.0, 0.0)), ("height", float("inf")),
    ],
)  # fmt: skip
def test_what_cannot_be_set_is_refused(field, value):
    with pytest.raises(InputError, match=field):
        Stage(**{field: value})


def test_a_picture_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="picture"):
        Stage(backdrop=PICTURE)
    (tmp_path / "no.png").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"no\.png"):
        backdrop(Stage(backdrop=PICTURE, picture=str(tmp_path / "no.png")), GREY, (8, 8))
    with pytest.raises(InputError, match=r"gone\.png"):
        backdrop(Stage(backdrop=PICTURE, picture=str(tmp_path / "gone.png")), GREY, (8, 8))
