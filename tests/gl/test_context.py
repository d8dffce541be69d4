"""One OpenGL context, or the reason why there is none."""

from concurrent.futures import ThreadPoolExecutor

import moderngl
import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.gl import (
    NoContext,
    current_context,
    gl_context,
    gl_unavailable,
    in_software,
    per_context,
    renderer_name,
    use_context,
)
from avatarrex.gl.binding import current_binding, nothing_current


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
    with current_context() as own:
        _ = own.error  # OpenGL keeps the first error until it is read: one that an earlier test left is not of this one
        kept = own.buffer(np.arange(4, dtype="u4").tobytes())
    with nothing_current():
        lent = moderngl.create_context(standalone=True, backend="egl", require=430)
        window = current_binding()
        use_context(lent)
        try:
            with current_context() as context:
                assert context is lent
                assert current_binding() == window
                lent.buffer(np.zeros(4, dtype="u4").tobytes())
        finally:
            use_context(None)
        assert gl_context() is own
        assert current_binding() == window, "the window may go on"
        with current_context():
            np.testing.assert_array_equal(np.frombuffer(kept.read(), "u4"), np.arange(4))
            assert own.error == "GL_NO_ERROR"


def test_work_goes_on_inside_another_program_and_leaves_its_context_current():
    with nothing_current():
        other = moderngl.create_context(standalone=True, backend="egl", require=330)
        theirs = current_binding()
        kept = other.buffer(b"abcd")
        with current_context() as context:
            assert current_binding() != theirs
            buffer = context.buffer(b"1234")
            with current_context():
                pass
            assert current_binding() != theirs, "the inner `with` gives back what the outer took"
            assert buffer.read() == b"1234"
            buffer.release()
        assert current_binding() == theirs
        assert kept.read() == b"abcd"
        assert (other.error, context.error) == ("GL_NO_ERROR", "GL_NO_ERROR")
        other.release()


def test_an_error_inside_gives_the_context_back():
    with nothing_current():
        with pytest.raises(ZeroDivisionError), current_context():
            raise ZeroDivisionError
        assert current_binding() is None


def test_threads_take_turns():
    with nothing_current(), ThreadPoolExecutor(3) as pool:
        read = list(pool.map(_written, range(30)))
    assert read == list(range(30))


def test_a_context_that_another_thread_keeps_is_an_error():
    with nothing_current(), ThreadPoolExecutor(1) as pool:
        gl_context()
        kept = current_binding()
        with pytest.raises(NoContext, match="current in another thread"):
            pool.submit(_written, 1).result()
        assert current_binding() == kept


def _written(number: int) -> int:
    """Through a buffer and back."""
    with current_context() as context:
        buffer = context.buffer(np.uint32(number).tobytes())
        try:
            return int(np.frombuffer(buffer.read(), "u4")[0])
        finally:
            buffer.release()


@pytest.mark.parametrize(
    ("renderer", "slow"),
    [
        ("llvmpipe (LLVM 15.0.6, 256 bits)", True),
        ("Google SwiftShader", True),
        ("Apple Software Renderer", True),
        ("D3D12 (Microsoft Basic Render Driver)", True),
        ("NVIDIA GeForce RTX 4070/PCIe/SSE2", False),
        ("AMD Radeon Graphics (radeonsi, raphael_mendocino, LLVM 15.0.7)", False),
    ],
)
def test_which_renderers_have_no_graphics_card(renderer, slow):
    assert in_software(renderer) is slow


def test_things_are_made_once_per_context():
    made = []
    for _ in range(2):
        per_context(gl_context(), "test_things_are_made_once", lambda: made.append(1) or made)
    assert made == [1]
