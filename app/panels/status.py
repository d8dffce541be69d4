"""The status bar: what the last frame cost, at which raster, on what, and which work it did not need to do."""

from __future__ import annotations

from avatarrex_studio.engine.skips import skipped
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.engine.work import Work
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import hello_imgui, imgui


def machine(work: Work, renderer: str) -> tuple[str, ...]:
    """The torch device, the OpenGL `renderer` where no note names it, and the picture's notes."""
    named = any(renderer in note for note in work.notes)
    return (f"torch: {work.device}", *(() if named else (f"OpenGL: {renderer}",)), *work.notes)


def draw(studio: Studio, renderer: str) -> None:
    """Draw the bar's items in one line; `renderer` is the window's GL_RENDERER."""
    work = studio.work
    items = [f"{hello_imgui.frame_rate():.0f} fps"]
    if work is not None:
        width, height = studio.size
        items += [
            f"{work.ms['total']:.0f} ms",
            f"{width} × {height} {studio.resolution.state.value}",
            f"level {work.level}",
            "skipped: " + (", ".join(skipped(work)) or "nothing"),
            *machine(work, renderer),
        ]
    for number, item in enumerate(items):
        if number:
            imgui.same_line(0, 10)
            imgui.text_colored(theme.vec4(theme.MUTED, 0.5), "|")
            imgui.same_line(0, 10)
        widgets.caption(item, theme.TEXT if number < 4 else theme.MUTED)
    if work is not None and imgui.is_item_hovered():
        stages = "   ".join(f"{name} {value:.1f} ms" for name, value in work.ms.items())
        imgui.set_tooltip(stages + "\n" + "\n".join(f"{name}: {count:,}" for name, count in work.counters.items()))
