"""The window's OpenGL context is taken away: found out, and the window opened anew with the same picture."""

from __future__ import annotations

import gc
import logging
from types import SimpleNamespace

import moderngl
import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.session.commands import SetJoint
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import SizePolicy, StudioState
from avatarrex_studio.window import window as window_module
from avatarrex_studio.window.context_loss import FAILURES, SOON, ContextLoss
from avatarrex_studio.window.window import Window, run
from ball import ball_engine
from ball_studio import InlineExact, ball_studio
from imgui_bundle import hello_imgui, immapp
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.stage.stage import Stage
from avatarrex.templates.person import load_person


def test_a_context_is_lost_where_its_driver_says_so_or_pictures_fail(clock):
    loss = ContextLoss(clock)
    assert not any(loss.found(True) for _ in range(10))
    loss.status = lambda: 0x8254  # GL_INNOCENT_CONTEXT_RESET
    assert loss.found(True)
    assert not loss.given_up
    loss.status, loss.works = lambda: 0, lambda: True
    clock.now += SOON
    assert not any(loss.found(False) for _ in range(10)), "another fault"
    assert not loss.found(True)
    loss.works = lambda: False
    assert [loss.found(drawn) for drawn in (False, False, True, *[False] * FAILURES)] == [False] * (2 + FAILURES) + [
        True
    ]
    assert not loss.given_up, "a minute later"
    clock.now += 1
    assert [loss.found(False) for _ in range(FAILURES)][-1]
    assert loss.given_up


def taken_away(context):
    """All that the program has in the context: textures, buffers, programs, arrays, targets."""
    kinds = (
        moderngl.Texture, moderngl.Buffer, moderngl.Program, moderngl.VertexArray, moderngl.Framebuffer, moderngl.Renderbuffer
    )  # fmt: skip
    found = [thing for thing in gc.get_objects() if type(thing) in kinds and thing.ctx is context and thing.glo]
    assert len(found) > 20
    for thing in found:
        thing.release()


def surface_window():
    """The template as a surface on a stage, small, at level `live`."""
    avatar = Avatar.create(load_person(), "compact")
    avatar.surface = template_surface()
    state = StudioState(size=SizePolicy(fixed=(160, 120)), level="live", stage=Stage(shown=True))
    return Window(Studio(InlineExact(ball_engine()), Avatars(lambda name: avatar), Journal(state), LiveSurface()))


def pixels(window):
    """What the viewport shows; called within the loop."""
    texture = window.screen.context.external_texture(window.screen.shown.texture, (160, 120), 4, 0, "f1")
    return np.frombuffer(texture.read(), np.uint8).reshape(120, 160, 4).copy()


class Lost:
    """Looks at the picture when it rests, then takes everything away, then looks again in the next window."""

    def __init__(self, window):
        self.window, self.pictures, self.frames = window, [], 0
        self._render, window._render = window._render, self.render

    def render(self):
        self._render()
        self.frames += 1
        window = self.window
        if self.frames == 40:
            self.pictures.append(pixels(window))
            if len(self.pictures) == 1:
                taken_away(window.screen.context)
                window.loss.status = lambda: 0x8255  # GL_UNKNOWN_CONTEXT_RESET
            else:
                hello_imgui.get_runner_params().app_shall_exit = True


@pytest.mark.window
def test_the_window_opens_anew_with_the_same_picture(display, caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(window_module, "IDLE_FPS", 60.0)  # else the frames until the picture rests take minutes
    window = surface_window()
    window.studio.do(SetJoint("left_elbow", (0.0, -1.0, 0.0)))
    lost = Lost(window)
    immapp.run(window.params((640, 480), remember=False))
    assert window.anew
    assert window.screen.context is None, "nothing of the old context is kept"
    assert not window.studio.pictures.exact.closed, "what the window showed goes on"
    assert window.autosave.file.exists() or window.autosave._writing is not None
    lost.frames = 0
    immapp.run(window.params((640, 480), remember=False))
    before, after = lost.pictures
    assert len(np.unique(before.reshape(-1, 4), axis=0)) > 100, "a person on a floor"
    assert np.array_equal(before, after)
    assert not window.anew
    assert window.guard.failed == {}
    assert "opened anew" in caplog.text
    assert window.studio.pictures.exact.closed
    assert not window.autosave.file.exists(), "a clean end"


def test_the_program_runs_the_window_again_and_gives_up_in_the_end(monkeypatch, clock):
    """Without a display: what `run` does around the toolkit's loop."""
    window = Window(ball_studio(clock))
    window.loss._clock, runs = clock, []

    def loop(params):
        runs.append(params)
        window.anew = False
        window.loss.status = lambda: 1
        if window.loss.found(True):
            window._lost()
        clock.now += 1

    monkeypatch.setattr(window_module, "immapp", SimpleNamespace(run=loop))
    monkeypatch.setattr(window_module, "first_size", lambda: (640, 400))
    monkeypatch.setattr(window, "params", lambda size: size)
    monkeypatch.setattr(window.loss, "ask", lambda: None)
    monkeypatch.setattr(window, "_exit", lambda: None)
    window.studio.do(SetJoint("left_elbow", (0.0, -1.0, 0.0)))
    assert run(window) == 1
    assert len(runs) == 2
    window.autosave._writing.result()
    assert window.autosave.file.exists(), "the next start offers it"
