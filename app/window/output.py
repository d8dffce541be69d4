"""The clean output window: the avatar alone, over nothing or a key colour, for a program that captures windows (OBS).

A window of its own that shares textures with the studio's: what the viewport shows of surface and exact picture is drawn there,
without panels, handles and overlays. A virtual camera, where `pyvirtualcam` is installed, gets the same picture.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import moderngl
import numpy as np
from avatarrex_studio.session.notice import NOTICE
from avatarrex_studio.session.state import Colour
from avatarrex_studio.window.layers import Layers
from avatarrex_studio.window.screen import Fade
from jaxtyping import UInt8

from avatarrex.gl.shader import draw_program

# isort: split
import glfw  # after imgui_bundle, which brings its own library and is imported by `screen`

log = logging.getLogger(__name__)
TITLE = "AvatarReX Studio output"
SIZES = {"wide": (1280, 720), "large": (1920, 1080), "high": (1080, 1920)}
"""Of the window, points; it opens with the first, and can be drawn to any."""
GROUNDS: dict[str, Colour] = {
    "transparent": (0.0, 0.0, 0.0, 0.0),
    "green": (0.0, 1.0, 0.0, 1.0),
    "black": (0.0, 0.0, 0.0, 1.0),
}
"""What is behind the avatar."""
CAMERA_FPS = 30.0
"""That a virtual camera is opened with."""


class Output:
    """Opened and closed by an action; draws when there is something new."""

    def __init__(self) -> None:
        self.size = SIZES["wide"]
        """Width and height that the window opens with, points."""
        self.ground = "transparent"
        """Of `GROUNDS`."""
        self.camera = VirtualCamera()
        self.pane: Pane | None = None
        """The window while it is open."""
        self._fade: Fade | None = None
        self._shown: tuple[object, ...] = ()

    def toggle(self, main: moderngl.Context) -> None:
        """Open the window beside the one whose context `main` is current, or close it."""
        if self.pane:
            self.pane.close()
            self.pane = None
            return
        try:
            self.pane, self._shown = Pane(main, self.size), ()
        except (
            RuntimeError,
            ValueError,
        ) as error:  # what glfw and moderngl raise where the system gives no second window
            log.error("the output window could not be opened: %s", error)
            return
        log.info("Output window: have your program capture the window '%s'", TITLE)

    def resize(self, name: str) -> None:
        """One of `SIZES` for the window, now or when it opens."""
        self.size = SIZES[name]
        if self.pane:
            self.pane.resize(self.size)

    def show(self, layers: Layers | None, main: moderngl.Context, new: bool) -> None:
        """Draw what the viewport shows, where it is `new` or the window or its ground is another. `main` is current, before and after."""
        if self.pane and self.pane.wants_to_close:
            self.toggle(main)
        shown = (self.ground, self.pane and self.pane.size, self.camera.running)
        if layers is None or not (self.pane or self.camera.running) or not (new or shown != self._shown):
            return
        self._shown = shown
        self._fade = self._fade or Fade(main)
        texture = self._fade.draw(layers, GROUNDS[self.ground])
        if self.camera.running:
            pixels = np.frombuffer(texture.read(), np.uint8).reshape(texture.height, texture.width, 4)
            self.camera.send(pixels)
        if self.pane:
            texture.ctx.finish()  # the other context reads what this one has drawn
            self.pane.draw(texture, GROUNDS[self.ground])

    def close(self) -> None:
        """Give everything back; the main context is current."""
        self.camera.stop()
        if self.pane:
            self.pane.close()
            self.pane = None
        if self._fade:
            self._fade.release()
            self._fade = None


class Pane:
    """A window without anything but a picture, in a context that shares textures with the one that is current. Raises `RuntimeError`."""

    def __init__(self, main: moderngl.Context, size: tuple[int, int]) -> None:
        """`size`: width and height, points."""
        version = main.version_code
        with _other_window_current() as current:
            for hint, value in {
                glfw.CONTEXT_VERSION_MAJOR: version // 100, glfw.CONTEXT_VERSION_MINOR: version // 10 % 10,
                glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE, glfw.TRANSPARENT_FRAMEBUFFER: True, glfw.FOCUS_ON_SHOW: False,
                glfw.CONTEXT_ROBUSTNESS: glfw.get_window_attrib(current, glfw.CONTEXT_ROBUSTNESS),  # contexts share within one kind
            }.items():  # fmt: skip
                glfw.window_hint(hint, value)
            self._window = glfw.create_window(*size, TITLE, None, current)
            glfw.default_window_hints()
            if not self._window:
                raise RuntimeError("the system gives no second window")
            glfw.make_context_current(self._window)
            glfw.swap_interval(0)  # the studio's window waits for the screen
            self._context = moderngl.create_context(require=version)
            self._program = draw_program(self._context, "window/whole.vert", "window/output.frag")
            self._triangle = self._context.vertex_array(self._program, [])

    @property
    def wants_to_close(self) -> bool:
        """Whether its close button was pressed."""
        return bool(glfw.window_should_close(self._window))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        width, height = glfw.get_framebuffer_size(self._window)
        return max(width, 1), max(height, 1)

    def resize(self, size: tuple[int, int]) -> None:
        """Another width and height, points."""
        glfw.set_window_size(self._window, *size)

    def draw(self, picture: moderngl.Texture, ground: Colour) -> None:
        """A straight-alpha picture of another context, as large as it fits, over a ground of the same colour as its own."""
        width, height = self.size
        scale = min(width / picture.width, height / picture.height)
        inner = round(picture.width * scale), round(picture.height * scale)
        red, green, blue, alpha = ground
        with _other_window_current():
            glfw.make_context_current(self._window)
            context = self._context
            context.external_texture(picture.glo, picture.size, 4, 0, "f1").use(0)
            context.screen.use()
            context.screen.viewport = (0, 0, width, height)
            context.clear(alpha * red, alpha * green, alpha * blue, alpha)
            context.screen.viewport = ((width - inner[0]) // 2, (height - inner[1]) // 2, *inner)
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
            glfw.swap_buffers(self._window)

    def close(self) -> None:
        """Close it."""
        with _other_window_current():
            glfw.make_context_current(self._window)
            self._triangle.release()
            self._program.release()
        glfw.destroy_window(self._window)


@contextmanager
def _other_window_current() -> Iterator[Any]:
    """Whatever the block makes current, the window that was is again after it."""
    current = glfw.get_current_context()
    try:
        yield current
    finally:
        glfw.make_context_current(current)


class VirtualCamera:
    """The picture as the camera of a video call, where the system has one to offer."""

    def __init__(self) -> None:
        self._device: Any = None
        self._wanted = False

    @property
    def running(self) -> bool:
        """Whether pictures are sent."""
        return self._wanted

    def toggle(self) -> None:
        """Start or stop; what is missing is said."""
        if self._wanted:
            self.stop()
            return
        try:
            import pyvirtualcam  # noqa: F401
        except ImportError:
            log.error("A virtual camera needs pyvirtualcam: pip install 'avatarrex-studio[camera]'")
            return
        self._wanted = True

    def send(self, picture: UInt8[np.ndarray, "h w 4"]) -> None:
        """Send straight-alpha bytes, over black where they are transparent; the device is opened with the first."""
        import pyvirtualcam

        pixels = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
        opaque = (pixels[..., :3].astype(np.uint16) * pixels[..., 3:] // 255).astype(np.uint8)
        height, width = opaque.shape[:2]
        try:
            if self._device is not None and (self._device.width, self._device.height) != (width, height):
                self._device.close()
                self._device = None
            if self._device is None:
                self._device = pyvirtualcam.Camera(width, height, CAMERA_FPS)
                log.log(NOTICE, "Virtual camera: %s, %d x %d", self._device.device, width, height)
            self._device.send(opaque)
        except (RuntimeError, OSError) as error:
            log.error(
                "No virtual camera: %s. On Linux load v4l2loopback, on Windows and macOS install OBS.",
                str(error).splitlines()[0],
            )
            self.stop()

    def stop(self) -> None:
        """Give the device back."""
        self._wanted = False
        if self._device is not None:
            self._device.close()
            self._device = None
