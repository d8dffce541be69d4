"""The stage in the program: off it changes nothing; on, pictures, files and the window show the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from avatarrex_studio.cli import main as cli
from avatarrex_studio.cli import options
from avatarrex_studio.cli.render import read_job
from avatarrex_studio.engine.pictures import Subject
from avatarrex_studio.engine.request import Request
from avatarrex_studio.engine.staging import in_light, over_stage
from avatarrex_studio.engine.worker import answered
from avatarrex_studio.jobs.export_look import Look
from avatarrex_studio.jobs.export_picture import Drawer
from avatarrex_studio.panels.stage import draw
from avatarrex_studio.session.commands import SetBackground, SetCamera, SetStage, SetTranslation, ShowPicture
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.window.layers import Layers
from avatarrex_studio.window.staging import Scene, Staging
from avatarrex_studio.window.window import start
from ball import ball_engine
from PIL import Image
from test_panels import find, screen  # noqa: F401  a fixture

from avatarrex.errors import InputError
from avatarrex.files.images import composite
from avatarrex.gl import gl_context
from avatarrex.signals.ground import floor_height
from avatarrex.stage.composite import staged
from avatarrex.stage.lighting import Lit
from avatarrex.stage.stage import COLOUR, PICTURE, Stage
from avatarrex.surface.floor import FloorLight
from avatarrex.surface.shadow import SurfaceShadow

SIZE = (48, 32)
OFF = SetCamera(azimuth=25.0, elevation=15.0, distance=4.0).apply(StudioState())
ON = OFF.change(stage=Stage(shown=True, exposure=-0.5))


def shadow(seed: int) -> FloorLight:
    """A smooth map about the origin."""
    x, z = np.meshgrid(np.linspace(0, 3, 24), np.linspace(0, 3, 24))
    key, sky = 0.5 + 0.5 * np.sin(x + seed), 0.6 + 0.4 * np.cos(z * x)
    return FloorLight((-1.5, -1.0, 1.5, 1.2), np.rint(255 * np.stack([key, sky], -1)).astype(np.uint8))


def test_a_stage_that_is_off_changes_no_byte():
    engine = ball_engine()
    frame = engine.render(OFF, SIZE).frame
    assert in_light([frame], OFF).image is frame.image
    unshown = OFF.change(stage=Stage(exposure=1.0, azimuth=0.0, backdrop=COLOUR))
    for state in (OFF, unshown):
        assert np.array_equal(over_stage(in_light([frame], state), state), composite(frame.image, state.background))
        picture = answered(engine, Request(state, SIZE)).picture
        assert np.array_equal(picture.image, np.rint(255 * frame.image.numpy().clip(0, 1)).astype(np.uint8))
        assert picture.floor is None


def test_a_picture_on_stage_comes_with_its_floor():
    picture = answered(ball_engine(), Request(ON, SIZE)).picture
    assert picture.floor.values.shape[2] == 2
    bare = ON.change(stage=replace(ON.stage, floor=False))
    assert answered(ball_engine(), Request(bare, SIZE)).picture.floor is None


def test_the_window_draws_what_files_get(tmp_path):
    """The shader against `staged`, for every background and while one picture is faded in over the other."""
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:] = np.linspace(10, 240, 8)[:, None, None]
    Image.fromarray(np.kron(pixels, np.ones((40, 60, 1), np.uint8))).save(tmp_path / "a.png")
    context, state = gl_context(), SetTranslation((0.2, 0.0, -0.1)).apply(ON)
    staging, width, height = Staging(context), *SIZE
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 2, (height, width, 1)) * rng.integers(0, 256, (height, width, 4)) for _ in range(2)]
    images = [np.minimum(image, image[..., 3:]).astype(np.uint8) for image in images]
    surface, exact = (context.texture(SIZE, 4, image.tobytes()) for image in images)
    maps = shadow(0), shadow(2)
    texture = context.texture((24, 24), 2, maps[0].values.tobytes(), alignment=1)
    drawn = SurfaceShadow(maps[0].region, texture, texture, np.eye(4))
    drawn.texture.repeat_x = drawn.texture.repeat_y = False

    def wanted(image, floor, now):
        return staged(
            torch.from_numpy(image / 255.0), now.view.camera(*SIZE), now.stage, now.background, floor, now.middle
        )

    for stage in (
        ON.stage,
        replace(ON.stage, floor=False),
        replace(ON.stage, backdrop=COLOUR, exposure=0.7),
        replace(ON.stage, backdrop=PICTURE, picture=str(tmp_path / "a.png"), height=-0.4),
    ):
        for colour in ((0.2, 0.5, 0.7, 1.0), (0.0, 0.0, 0.0, 0.0)):
            now = SetBackground(colour).apply(state.change(stage=stage))
            camera, loose = now.view.camera(*SIZE), 1 if stage.backdrop != PICTURE else 12
            for weight, layers, scene, image, floor in (
                (0.0, Layers(surface, None, 0.0), Scene(now, camera, drawn, None), images[0], maps[0]),
                (1.0, Layers(None, exact, 1.0), Scene(now, camera, None, maps[1]), images[1], maps[1]),
            ):
                got = np.frombuffer(staging.draw(layers, scene).read(), np.uint8).reshape(height, width, 4).astype(int)
                apart = np.abs(got - wanted(image, floor, now))[got[..., 3] > 40]
                assert apart.max() <= loose + (colour[3] == 0), (stage.backdrop, colour, weight)
    nobody = context.texture(SIZE, 4, bytes(4 * width * height))
    half = staging.draw(Layers(nobody, nobody, 0.4), Scene(state, state.view.camera(*SIZE), drawn, maps[1]))
    empty = np.zeros((height, width, 4), np.uint8)
    ends = [wanted(empty, floor, state).astype(float) for floor in maps]
    got = np.frombuffer(half.read(), np.uint8).reshape(height, width, 4)
    assert np.abs(got - (0.6 * ends[0] + 0.4 * ends[1])).max() <= 1.5
    staging.release()


def test_a_background_that_is_gone_is_said_once_and_the_gradient_shown(tmp_path, caplog):
    staging, state = (
        Staging(gl_context()),
        ON.change(stage=replace(ON.stage, backdrop=PICTURE, picture=str(tmp_path / "x.png"))),
    )
    nobody = gl_context().texture(SIZE, 4, bytes(4 * SIZE[0] * SIZE[1]))
    scenes = [Scene(now, now.view.camera(*SIZE), None, None) for now in (state, state)]
    drawn = [staging.draw(Layers(nobody, None, 0.0), scene).read() for scene in scenes]
    assert [record.message for record in caplog.records if "x.png" in record.message] == [caplog.records[0].message]
    shades = np.frombuffer(drawn[0], np.uint8).reshape(SIZE[1], SIZE[0], 4)
    assert shades[0, 0, 0] < shades[-1, 0, 0]
    staging.release()


def test_what_the_light_depends_on_makes_another_picture():
    subject = Subject.of(ON, SIZE)
    assert Subject.of(SetStage("exposure", 1.0).apply(ON), SIZE) == subject
    assert Subject.of(SetStage("backdrop", COLOUR).apply(ON), SIZE) == subject
    for name, value in {
        "azimuth": 0.0,
        "softness": 9.0,
        "shadow": 0.1,
        "height": 0.0,
        "floor": False,
        "shown": False,
    }.items():
        assert Subject.of(SetStage(name, value).apply(ON), SIZE) != subject
    normals = ShowPicture("normals").apply(ON)
    assert Subject.of(normals, SIZE).light is None
    assert Subject.of(OFF, SIZE) == Subject.of(SetStage("azimuth", 0.0).apply(OFF), SIZE)


def test_the_stage_is_undone_and_saved(tmp_path):
    journal = Journal(start())
    assert journal.state.stage.shown
    for value in (10.0, 20.0, 30.0):
        journal.do(SetStage("azimuth", value), ("drag", 1))
    journal.do(SetStage("top", (0.1, 0.2, 0.3)))
    journal.save(tmp_path / "a.json")
    assert Journal.load(tmp_path / "a.json").state == journal.state
    journal.undo()
    assert journal.undo().stage == Stage(shown=True)
    with pytest.raises(InputError, match="elevation"):
        journal.do(SetStage("elevation", 1.0))
    with pytest.raises(InputError, match="carpet"):
        journal.do(SetStage("carpet", True))
    data = OFF.to_json()
    del data["stage"]
    assert StudioState.from_json(data | {"format": 3}) == OFF


def test_an_export_has_the_stage_where_it_is_ticked():
    engine = ball_engine()
    plain, on, clear, clear_on = (
        Drawer(engine, Look(SIZE, level="balanced", clear=clear, stage=stage)).pixels(ON)
        for clear in (False, True)
        for stage in (False, True)
    )
    assert np.array_equal(plain, Drawer(engine, Look(SIZE, level="balanced")).pixels(OFF))
    assert not np.array_equal(plain, on)
    assert np.array_equal(on, over_stage(in_light([engine.render(ON, SIZE).frame], ON), ON))
    assert clear[0, 0, 3] == 0
    assert clear_on[0, 0, 3] == 0


def test_render_takes_a_stage(tmp_path):
    def job(*words):
        return read_job(cli.parse(["render", str(tmp_path / "a.png"), *words])).start

    assert not job().stage.shown
    standing = job("--stage").stage
    assert replace(standing, height=None) == Stage(shown=True)
    assert standing.height == pytest.approx(floor_height(), abs=0.01)
    chosen = job("--stage", "azimuth=-20,softness=8,floor=0,height=-1,top=#ff0000,bottom=black,exposure=0.5").stage
    assert (chosen.azimuth, chosen.softness, chosen.floor, chosen.height, chosen.exposure) == (-20, 8, False, -1, 0.5)
    assert (chosen.top, chosen.bottom) == ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert job("--stage", "--background", "white").stage.backdrop == COLOUR
    assert job("--stage", "--pose", "squat").stage.height > floor_height() + 0.2, "the feet are drawn up"
    Image.new("RGB", (4, 4)).save(tmp_path / "b.png")
    assert job("--stage", f"picture={tmp_path / 'b.png'}").stage.backdrop == PICTURE


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("carpet=1", "carpet"), ("azimuth=north", "azimuth"), ("elevation=3", "elevation"), ("top=nocolour", "top"),
        ("picture=/nowhere/a.png", "picture"), ("picture=", "picture"), ("floor", "floor"), ("floor=2", "floor"), ("floor=yes", "floor"),
    ],
)  # fmt: skip
def test_a_stage_that_cannot_be_is_refused(text, named):
    with pytest.raises(InputError, match=named):
        options.stage(text, False)


def test_a_file_that_is_no_picture_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"a\.png"):
        options.stage(f"picture={tmp_path / 'a.png'}", False)


def test_the_panel_sets_the_stage(screen):  # noqa: F811
    commands = find(screen, lambda: draw(ON), lambda command: getattr(command, "name", "") == "softness")
    assert commands[-1].value > ON.stage.softness
    for command in commands:
        assert command.apply(ON).stage.softness == command.value
    assert not screen.drag(lambda: draw(OFF), (150, 60), (158, 60)), "what is off is greyed"


def test_lit_frames_of_a_level_without_volume(tmp_path):
    """The ball's frame has a volume with nothing in it: no shadow, and the side that turns away is darker."""
    frame = ball_engine().render(ON, SIZE).frame
    seen = in_light([frame], ON)
    assert isinstance(seen, Lit)
    assert (seen.floor.values == 255).all()
