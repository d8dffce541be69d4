"""File → Export…: what, how, and where to. The answer is what makes the order."""

from __future__ import annotations

import os
from collections.abc import Callable

from avatarrex_studio.jobs.export_look import SAMPLES
from avatarrex_studio.jobs.export_order import EXPORTED, FOLDER, Order
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.export_form import ABOUT, ALONE, ExportForm, Frames
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.session.state import AUTO, LEVELS, SIZES, StudioState
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx

from avatarrex.errors import plain
from avatarrex.levels import ABOUT as ABOUT_LEVELS

TITLE = "Export###export"
SIZE, KINDS_WIDTH, LABEL, BUTTON, ICON_WIDTH = imgui.ImVec2(660, 430), 120.0, 104.0, 110.0, 34.0
ICONS = {
    "Picture": icons.ICON_FA_IMAGE, "Layers": icons.ICON_FA_LAYER_GROUP, "Video": icons.ICON_FA_FILM, "3D model": icons.ICON_FA_CUBE,
    "Signals": icons.ICON_FA_WAVE_SQUARE, "Camera": icons.ICON_FA_CAMERA,
}  # fmt: skip
RASTERS = {
    "512 × 512": (512, 512), "1024 × 1024": (1024, 1024), "2048 × 2048": (2048, 2048), "1280 × 720": (1280, 720),
    "1920 × 1080": (1920, 1080), "1080 × 1920": (1080, 1920), "3840 × 2160": (3840, 2160),
}  # fmt: skip


class ExportDialog:
    """The dialog and the fields that it keeps from one time to the next."""

    def __init__(self) -> None:
        self.form, self.files = ExportForm(), FileDialog()
        self.error = ""
        """Why the last order was refused."""
        self._opening = False

    def open(self, viewport: tuple[int, int], state: StudioState, frames: Frames | None, error: str = "") -> None:
        """Show it, filled in for what is shown."""
        self.form.begin(viewport, state, frames)
        self.show(error)

    def show(self, error: str = "") -> None:
        """Show it as it was left."""
        self._opening, self.error = True, error

    def draw(self, state: StudioState, frames: Frames | None) -> Callable[[], Order] | None:
        """Draw it where it is open; what makes the order once *Export* is pressed."""
        if self._opening:
            imgui.open_popup(TITLE)
            self._opening = False
        screen = imgui.get_main_viewport()
        imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.appearing, imgui.ImVec2(0.5, 0.5))
        imgui.set_next_window_size(
            (min(SIZE.x, screen.size.x - 40), min(SIZE.y, screen.size.y - 40)), imgui.Cond_.appearing
        )
        if not imgui.begin_popup_modal(TITLE, True, imgui.WindowFlags_.no_saved_settings)[0]:
            return None
        height = -2 * imgui.get_frame_height_with_spacing() - (24 if self.error else 4)
        with imgui_ctx.begin_child("##kinds", imgui.ImVec2(KINDS_WIDTH, height)):
            for kind in EXPORTED:
                if imgui.selectable(f"##kind.{kind}", kind == self.form.kind)[0]:
                    self.form.kind, self.error = kind, ""
                imgui.same_line(8)
                imgui.text(ICONS[kind])
                imgui.same_line(ICON_WIDTH)
                imgui.text(kind)
        imgui.same_line()
        with imgui_ctx.begin_child("##fields", imgui.ImVec2(0, height)):
            self._fields(frames, state)
        if self.error:
            widgets.paragraph(self.error, theme.ERROR)
        pressed = self._where()
        self.files.draw()
        if pressed:
            imgui.close_current_popup()
        imgui.end_popup()
        return self.form.order(state, frames) if pressed else None

    def _fields(self, frames: Frames | None, state: StudioState) -> None:
        form = self.form
        widgets.label("Format", LABEL)
        endings = EXPORTED[form.kind]
        titles = {_title(ending): ABOUT[ending] for ending in endings}
        picked = widgets.choice("##format", titles, _title(form.ending), _title(form.ending), titles)
        form.format[form.kind] = next((ending for ending in endings if _title(ending) == picked), form.ending)
        widgets.label("", LABEL)
        about = (
            "a JSON file of calibrated cameras, as captures have it" if form.kind == "Camera" else ABOUT[form.ending]
        )
        widgets.paragraph(about[0].upper() + about[1:])
        if state.others and form.kind in ALONE:
            widgets.label("", LABEL)
            widgets.paragraph(f"Of the selected avatar alone ({plain(os.path.basename(state.avatar))})", theme.TEXT)
        if form.moves:
            self._motion(frames)
        if form.drawn:
            self._pictures()

    def _motion(self, frames: Frames | None) -> None:
        """Which frames."""
        form, video = self.form, self.form.kind == "Video"
        if frames is not None:
            widgets.label("Motion", LABEL)
            _, form.moving = imgui.checkbox("All its frames" if not video else "Plays##motion", form.moving)
        if frames is not None and form.moving:
            widgets.label("Frames", LABEL)
            imgui.set_next_item_width(150)
            changed, ends = imgui.input_int2("##frames", [form.first, form.last])
            if changed:
                form.first = min(max(ends[0], 0), frames.count - 1)
                form.last = min(max(ends[1], form.first), frames.count - 1)
        elif video:
            widgets.label("Seconds", LABEL)
            imgui.set_next_item_width(150)
            _, form.seconds = imgui.input_float("##seconds", form.seconds, 1.0, 1.0, "%.1f")
            form.seconds = min(max(form.seconds, 0.1), 600.0)
        if not video:
            return
        widgets.label("Rate", LABEL)
        imgui.set_next_item_width(150)
        _, form.rate = imgui.input_float("##rate", form.rate, 0.0, 0.0, "%.3g a second")
        form.rate = min(max(form.rate, 1.0), 240.0)
        imgui.same_line()
        widgets.caption(f"{form.count(frames):,} pictures")
        widgets.label("Turntable", LABEL)
        imgui.set_next_item_width(150)
        _, form.turns = imgui.input_float("##turns", form.turns, 0.5, 1.0, "%.3g turns")

    def _pictures(self) -> None:
        """Raster, level, background, labels."""
        form = self.form
        widgets.label("Size", LABEL)
        imgui.set_next_item_width(150)
        changed, sides = imgui.input_int2("##size", list(form.size))
        if changed:
            form.size = tuple(min(max(side, SIZES[0]), SIZES[1]) for side in sides)  # type: ignore[assignment]
        imgui.same_line()
        imgui.set_next_item_width(28)
        if picked := widgets.choice("##rasters", RASTERS, "", ""):
            form.size = RASTERS[picked]
        widgets.label("Samples", LABEL)
        imgui.set_next_item_width(150)
        names = {n: f"{n * n} a pixel" for n in SAMPLES}
        if picked := widgets.choice("##samples", names.values(), names[form.samples], names[form.samples]):
            form.samples = next(n for n in SAMPLES if names[n] == picked)
        widgets.label("Level", LABEL)
        imgui.set_next_item_width(150)
        level, levels = form.levels[form.kind], [name for name in LEVELS if name != AUTO]
        form.levels[form.kind] = widgets.choice("##level", levels, level, level, _about_levels()) or level
        widgets.tooltip(_about_levels()[form.levels[form.kind]])
        if form.ending not in (".jpg", ".mp4", ".exr"):
            widgets.label("Background", LABEL)
            _, form.clear = imgui.checkbox("Transparent", form.clear)
        else:
            form.clear = form.ending == ".exr"
        if form.kind != "Layers":
            widgets.label("Stage", LABEL)
            _, form.stage = imgui.checkbox("Floor and light##stage", form.stage)
            widgets.tooltip(
                "As the Scene panel has them, where its stage is shown; a transparent picture keeps the shadow"
            )
        if form.kind == "Layers":
            form.marked = form.labelled = False
            return
        widgets.label("Watermark", LABEL)
        _, form.marked = imgui.checkbox("Invisible", form.marked)
        widgets.tooltip("A mark that `avatarrex-studio inspect` finds, in a smaller JPEG, too")
        imgui.same_line()
        _, form.labelled = imgui.checkbox("Label##labelled", form.labelled)
        if form.labelled:
            imgui.same_line()
            widgets.fill()
            _, form.label = imgui.input_text("##label", form.label)

    def _where(self) -> bool:
        """The path and the buttons; whether *Export* was pressed."""
        form = self.form
        imgui.align_text_to_frame_padding()
        widgets.caption("To")
        imgui.same_line(KINDS_WIDTH + 18)
        widgets.fill(150)
        _, path = imgui.input_text("##path", str(form.path))
        if path != str(form.path):
            form.take(path)
        imgui.same_line()
        if imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}  Browse…###browse", (-1, 0)):
            self.files.save(form.kind, f"Export: {form.kind.lower()}", form.take, form.path.parent)
        imgui.set_cursor_pos_x(
            imgui.get_cursor_pos_x() + widgets.room() - 2 * BUTTON - imgui.get_style().item_spacing.x
        )
        with imgui_ctx.push_style_color(imgui.Col_.button, theme.vec4(theme.ACCENT, 0.55)):
            pressed = imgui.button("Export###answer", (BUTTON, 0))
        imgui.same_line()
        if imgui.button("Cancel", (BUTTON, 0)):
            imgui.close_current_popup()
        return pressed


def _title(ending: str) -> str:
    return "Folder of PNG" if ending == FOLDER else ending[1:].upper()


def _about_levels() -> dict[str, str]:
    """What each level is, for its tooltip."""
    return {name: text[0].upper() + text[1:] for name, text in ABOUT_LEVELS.items()}
