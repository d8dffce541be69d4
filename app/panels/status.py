"""The status bar: the interface's rate, what surface and exact picture cost, on what, and which work was not needed."""

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


def condition(studio: Studio) -> str:
    """How the exact picture stands to the present state."""
    if studio.pictures.exact.busy:
        return "rendering…"
    return f"{studio.age:.0f} s old" if studio.pictures.current else "of an earlier state"


def draw(studio: Studio, renderer: str, job: str = "", listens: str = "") -> None:
    """Draw the bar's items in one line; `renderer` is the window's GL_RENDERER, `job` what is under way in the background.

    `listens`: what listens for live sources; it comes first.
    """
    picture = studio.pictures.picture
    work = picture.work if picture else None
    items = [f"{hello_imgui.frame_rate():.0f} fps"]
    items = [listens, *items] if listens else items
    if studio.surface is not None and studio.live is not None:
        items.append(f"live {studio.live.ms['total']:.1f} ms")
    if picture is not None and work is not None:
        height, width = picture.image.shape[:2]
        items += [
            f"{work.level} {work.ms['total']:.0f} ms",
            f"{width} × {height} {condition(studio)}",
            "skipped: " + (", ".join(skipped(work)) or "nothing"),
            *machine(work, renderer),
        ]
    items += [job] if job else []
    for number, item in enumerate(items):
        if number:
            imgui.same_line(0, 10)
            imgui.text_colored(theme.vec4(theme.MUTED, 0.5), "|")
            imgui.same_line(0, 10)
        widgets.caption(item, theme.TEXT if number < 4 else theme.MUTED)
    if work is not None and imgui.is_item_hovered():
        stages = "   ".join(f"{name} {value:.1f} ms" for name, value in work.ms.items())
        imgui.set_tooltip(stages + "\n" + "\n".join(f"{name}: {count:,}" for name, count in work.counters.items()))
