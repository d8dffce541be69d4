"""The status bar: what listens, which picture is shown, what is under way. How it was made is told where the mouse rests on it."""

from __future__ import annotations

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.engine.work import Work
from avatarrex_studio.panels import theme, widgets
from imgui_bundle import hello_imgui, imgui


def machine(work: Work, renderer: str) -> tuple[str, ...]:
    """The torch device, the OpenGL `renderer` where no note names it, and the picture's notes."""
    named = any(renderer in note for note in work.notes)
    return (f"torch: {work.device}", *(() if named else (f"OpenGL: {renderer}",)), *work.notes)


def condition(studio: Studio) -> str:
    """How the exact picture stands to the present state."""
    if studio.pictures.exact.busy:
        return "rendering…"
    return "" if studio.pictures.current else "of an earlier state"


def shown(studio: Studio) -> list[str]:
    """Which pictures are shown: the surface while something moves, the exact one at rest."""
    picture, live = studio.pictures.picture, studio.live
    items = []
    if studio.moving and studio.surface is not None and live is not None:
        items.append(f"{hello_imgui.frame_rate():.0f} fps")
    elif picture is not None:
        height, width = picture.image.shape[:2]
        items += [f"{picture.work.level}, {width} × {height}", condition(studio)]
    elif studio.pictures.exact.busy:
        items.append(condition(studio))
    return [item for item in items if item]


def draw(studio: Studio, renderer: str, job: str = "", listens: str = "") -> None:
    """Draw the bar's items in one line; `renderer` is the window's GL_RENDERER, `job` what is under way in the background.

    `listens`: what listens for live sources; it comes first.
    """
    items = [item for item in (listens, *shown(studio), job) if item]
    for number, item in enumerate(items):
        if number:
            imgui.same_line(0, 10)
            imgui.text_colored(theme.vec4(theme.MUTED, 0.5), "|")
            imgui.same_line(0, 10)
        widgets.caption(item, theme.MUTED if item == job else theme.TEXT)
        if studio.pictures.picture is not None and imgui.is_item_hovered():
            imgui.set_tooltip(details(studio.pictures.picture.work, renderer))


def details(work: Work, renderer: str) -> str:
    """How the last exact picture was made."""
    stages = "   ".join(f"{name} {value:.1f} ms" for name, value in work.ms.items())
    counters = (f"{name}: {count:,}" for name, count in work.counters.items())
    return "\n".join((stages, *machine(work, renderer), *counters))
