"""One OpenGL context, or the reason why there is none."""

import moderngl
import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.gl import NoContext, gl_context, gl_unavailable, per_context, renderer_name, use_context


def test_the_context_is_made_once_and_names_its_renderer():
    context = gl_context()
    assert gl_context() is context
    assert context.version_code >= 430
    assert renderer_name(context)
    assert gl_unavailable() is None


def test_off_says_so(monkeypatch):
    monkeypatch.setenv("AVATARREX_GL", "off")
    assert "AVATARREX_GL=off" in str(gl_unavailable())
    with pytest.raises(NoContext, match="AVATARREX_GL=off"):
        gl_context()


def test_an_unknown_choice_is_refused(monkeypatch):
    monkeypatch.setenv("AVATARREX_GL", "vulkan")
    with pytest.raises(InputError, match=r"AVATARREX_GL: expected auto \| egl \| glfw \| off, found vulkan"):
        gl_context()


def test_a_failure_keeps_every_cause(monkeypatch):
    from avatarrex.gl import context as module

    def refuse(**settings):
        raise ValueError(f"no device {settings.get('device_index', 'default')}")

    monkeypatch.setattr(module, "_made", None)
    monkeypatch.setattr(module, "_reason", None)
    monkeypatch.setattr(moderngl, "create_context", refuse)
    monkeypatch.setenv("AVATARREX_GL", "egl")
    with pytest.raises(NoContext, match=r"no device default; no device 0; .*no device 3"):
        gl_context()


def test_a_window_lends_its_context_and_takes_it_back():
    own = gl_context()
    held = own.buffer(np.arange(4, dtype="u4").tobytes())
    lent = moderngl.create_context(standalone=True, backend="egl", require=430)
    use_context(lent)
    try:
        assert gl_context() is lent
        lent.buffer(np.zeros(4, dtype="u4").tobytes())
    finally:
        use_context(None)
    assert gl_context() is own
    # The own context is current again: its buffers read what was written.
    np.testing.assert_array_equal(np.frombuffer(held.read(), "u4"), np.arange(4))
    assert own.error == "GL_NO_ERROR"


def test_things_are_made_once_per_context():
    made = []
    for _ in range(2):
        per_context(gl_context(), "test_things_are_made_once", lambda: made.append(1) or made)
    assert made == [1]
