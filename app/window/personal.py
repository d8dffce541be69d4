"""What is the user's own of a window: preferences and what they change, the hint and the tour, how large all is."""

from __future__ import annotations

from dataclasses import replace

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import curves, keys, theme, units
from avatarrex_studio.panels.palette import Palette
from avatarrex_studio.panels.preferences import PreferencesDialog
from avatarrex_studio.panels.tour import Tour, draw_hint
from avatarrex_studio.panels.viewport import ViewportPanel
from avatarrex_studio.session.preferences import Preferences, read_preferences, write_preferences
from avatarrex_studio.window.docking import show_panel
from avatarrex_studio.window.interface_scale import InterfaceScale
from imgui_bundle import hello_imgui, imgui


class Personal:
    """One window's."""

    def __init__(self, studio: Studio, viewport: ViewportPanel, palette: Palette) -> None:
        self.preferences = read_preferences()
        self.scale, self.tour, self.dialog = InterfaceScale(), Tour(), PreferencesDialog()
        self._studio, self._viewport, self._palette = studio, viewport, palette
        self._applied: Preferences | None = None

    def open(self) -> None:
        """The window is there, for the first time or anew."""
        self._applied = None
        self.scale.preferred = self.preferences.scale
        self.scale.open()

    def greet(self) -> None:
        """Have the avatar move gently, where that is wanted."""
        if self.preferences.greeting:
            self._studio.greet()

    def prepare(self) -> None:
        """Before the interface's frame: do what preferences say, where they have changed."""
        now = self.preferences
        if now == self._applied:
            return
        if self._applied is None or now.theme != self._applied.theme:
            curves.close()  # made anew in its colours
            theme.use(now.theme)
            hello_imgui.get_runner_params().imgui_window_params.background_color = theme.vec4(theme.PANEL)
        units.use(now.angles, now.lengths)
        self._viewport.preset = self._palette.preset = self.tour.preset = now.mouse
        self.scale.preferred = now.scale
        hello_imgui.get_runner_params().fps_idling.fps_max = now.fps
        self._studio.adaptive.limit = now.fps
        self._applied = now

    def draw(self) -> None:
        """What lies over the panels; and see whether somebody has done something."""
        if self._studio.greeting and keys.anything():
            self._studio.end_greeting()
        after = self.dialog.draw(self.preferences)
        self.tour.draw()
        if imgui.is_key_pressed(imgui.Key.escape, False) and keys.free():
            self.tour.stop()
        if self.tour.reveal:
            show_panel(self.tour.reveal)  # panels may be hidden
            self.tour.reveal = ""
        self._prefer(after)

    def draw_hint(self) -> None:
        """In the menu bar."""
        if self.preferences.hint and self.tour.number is None and not draw_hint(self.tour):
            self._prefer(replace(self.preferences, hint=False))

    def _prefer(self, preferences: Preferences) -> None:
        if preferences != self.preferences:
            self.preferences = preferences
            write_preferences(preferences)
