"""Every action once: menus, palette, shortcuts and the help sheet read this list.

An action either is a command on the state or names an effect, a method of the studio or the window.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from avatarrex_studio.session import commands
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.grip import handle_of
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.state import IMAGE, LEVELS, StudioState
from avatarrex_studio.session.timeline_commands import CloseMotion

from avatarrex.signals.handles import HANDLES
from avatarrex.signals.library import EXPRESSIONS, HANDS, POSES
from avatarrex.templates.parts import PARTS


@dataclass(frozen=True)
class Action:
    """One thing a user can do."""

    id: str
    title: str
    menu: str = ""
    """Menu it is in, `View/Level` for one in a menu of that; the palette has all."""
    shortcut: str = ""
    """e.g. `Ctrl+Shift+Z`."""
    command: Callable[[StudioState], Command] | None = None
    effect: str | None = None
    """A method of the studio or the window, where there is no command."""
    enabled: Callable[[Journal], bool] = lambda journal: True
    on: Callable[[StudioState], bool] | None = None
    """Whether what it shows or chooses is so now, where that can be said: menus tick it."""
    separator: bool = False
    """Whether a line separates it from the entry above."""


@cache
def words(name: str) -> str:
    """A name as a person writes it: `left_hand` → `left hand`, `mouthSmileLeft` → `mouth smile left`."""
    return " ".join(re.findall(r"[A-Z]?[a-z]+\d*", name)).lower()


def _has_layers(journal: Journal) -> bool:
    return bool(journal.state.timeline.layers)


def _can_play(journal: Journal) -> bool:
    return any(figure.timeline.layers for figure in journal.state.figures)


def _has_motion(journal: Journal) -> bool:
    return journal.state.timeline.motion is not None


def _has_several(journal: Journal) -> bool:
    return bool(journal.state.others)


def _next_figure(state: StudioState) -> Command:
    return commands.SelectFigure((state.slot + 1) % (len(state.others) + 1))


def _view(azimuth: float, elevation: float) -> Callable[[StudioState], Command]:
    return lambda state: commands.SetCamera(azimuth=azimuth, elevation=elevation)


def _has_handle(journal: Journal) -> bool:
    return handle_of(journal.state.tools.selected) is not None


def _pin(state: StudioState) -> Command:
    handle = handle_of(state.tools.selected)
    return commands.Pin((handle,), handle not in state.tools.pins) if handle else commands.Select(state.tools.selected)


def _pin_feet(state: StudioState) -> Command:
    feet = ("left_foot", "right_foot")
    return commands.Pin(feet, not state.tools.pins.issuperset(feet))


def _overlay(name: str) -> Callable[[StudioState], Command]:
    return lambda state: commands.ShowOverlay(name, name not in state.tools.overlays)


def _picture(name: str) -> Callable[[StudioState], Command]:
    """Shown, or the image again."""
    return lambda state: commands.ShowPicture(IMAGE if state.tools.shows == name else name)


def _overlaid(name: str) -> Callable[[StudioState], bool]:
    return lambda state: name in state.tools.overlays


def _shows(name: str) -> Callable[[StudioState], bool]:
    return lambda state: state.tools.shows == name


def _seen(part: str) -> Callable[[StudioState], bool]:
    return lambda state: part not in state.hidden


def _at_level(name: str) -> Callable[[StudioState], bool]:
    return lambda state: state.level == name


def _toggle(part: str) -> Callable[[StudioState], Command]:
    return lambda state: commands.SetHidden(part, part not in state.hidden)


def _fixed(command: Command) -> Callable[[StudioState], Command]:
    return lambda state: command


def _named(kind: str, name: str, command: Command) -> Action:
    """An entry of the pose library."""
    return Action(f"library.{kind}.{name}", f"{kind.capitalize()}: {words(name)}", command=_fixed(command))


ACTIONS: tuple[Action, ...] = (
    Action("open", "Open…", "File", "Ctrl+O", effect="open"),
    Action("figure.add", "Add an avatar beside…", "File", effect="add_figure"),
    Action("capture.import", "Import a capture…", "File", effect="import_capture"),
    Action("motion.close", "Close the timeline", "File", command=_fixed(CloseMotion()), enabled=_has_layers),
    Action("session.save", "Save session", "File", "Ctrl+S", effect="save_session", separator=True),
    Action("session.save_as", "Save session as…", "File", "Ctrl+Shift+S", effect="save_session_as"),
    Action("export", "Export…", "File", "Ctrl+E", effect="export", separator=True),
    Action("screenshot", "Save a picture of the view", "File", "F12", effect="screenshot"),
    Action("quit", "Quit", "File", "Ctrl+Q", effect="quit", separator=True),
    Action("undo", "Undo", "Edit", "Ctrl+Z", effect="undo", enabled=lambda journal: bool(journal.steps)),
    Action("redo", "Redo", "Edit", "Ctrl+Shift+Z", effect="redo", enabled=lambda journal: bool(journal.undone)),
    Action("pose.copy", "Copy pose", "Edit", "Ctrl+C", effect="copy_pose", separator=True),
    Action("pose.paste", "Paste pose", "Edit", "Ctrl+V", effect="paste_pose"),
    Action("pose.paste_flipped", "Paste pose flipped", "Edit", "Ctrl+Shift+V", effect="paste_flipped"),
    Action("preferences", "Preferences…", "Edit", "Ctrl+,", effect="preferences", separator=True),
    Action("pose.mirror", "Mirror pose", "Pose", "M", command=_fixed(commands.Mirror())),
    Action("pose.reset", "Reset everything", "Pose", "Ctrl+R", command=_fixed(commands.Reset())),
    Action("pose.reset_body", "Reset body", "Pose", command=_fixed(commands.ResetGroup("body")), separator=True),
    *(
        Action(f"pose.reset_{part}", f"Reset {words(part)}", "Pose", command=_fixed(commands.ResetGroup(part)))
        for part in PARTS
    ),
    Action("pose.reset_root", "Reset place", "Pose", command=_fixed(commands.ResetGroup("root"))),
    Action("pose.floor", "Put on the floor", "Pose", "Shift+G", command=_fixed(commands.PutOnFloor())),
    Action("look.camera", "Look at the camera", "Pose", effect="look_at_camera", separator=True),
    Action("pin.selected", "Pin or unpin what is selected", "Pose", "P", command=_pin, enabled=_has_handle),
    Action("pin.feet", "Pin or unpin both feet", "Pose", command=_pin_feet),
    Action("pin.none", "Unpin everything", "Pose", command=_fixed(commands.Pin(tuple(HANDLES), False))),
    Action("figure.next", "Select the next avatar", "Edit", "A", command=_next_figure, enabled=_has_several),
    Action("select.none", "Select nothing", "Edit", "Escape", command=_fixed(commands.Select(None))),
    Action("view.front", "Front view", "View", "1", command=_view(0.0, 0.0)),
    Action("view.right", "Right view", "View", "3", command=_view(-90.0, 0.0)),
    Action("view.top", "Top view", "View", "7", command=_view(0.0, 89.0)),
    Action("view.back", "Back view", "View", "Ctrl+1", command=_view(180.0, 0.0)),
    Action("view.left", "Left view", "View", "Ctrl+3", command=_view(90.0, 0.0)),
    Action("view.orthographic", "Perspective or orthographic", "View", "5",
            command=lambda state: commands.SetCamera(orthographic=not state.view.orthographic),
            on=lambda state: state.view.orthographic),
    Action("view.home", "Whole person, or all", "View", "Home", effect="whole_person", separator=True),
    Action("view.face", "Frame the face", "View", "F", effect="frame_face"),
    *(Action(f"view.{side}_hand", f"Frame the {side} hand", "View", effect=f"frame_{side}_hand") for side in ("left", "right")),
    Action("view.orbit_left", "Turn left", "", "4", command=_fixed(commands.OrbitBy(-15.0, 0.0))),
    Action("view.orbit_right", "Turn right", "", "6", command=_fixed(commands.OrbitBy(15.0, 0.0))),
    Action("overlay.joints", "Joints", "View", "J", command=_overlay("joints"), on=_overlaid("joints"), separator=True),
    Action("overlay.wire", "Template wire", "View", command=_overlay("wire"), on=_overlaid("wire")),
    Action("show.image", "Show the picture", "View/Inspect", command=_fixed(commands.ShowPicture(IMAGE)), on=_shows(IMAGE)),
    *(
        Action(f"show.{name}", title, "View/Inspect", key, command=_picture(name), on=_shows(name))
        for name, title, key in (
            ("normals", "Show normals", "N"), ("depth", "Show depth", "D"), ("parts", "Show parts", ""), ("steps", "Show ray steps", ""),
            ("influence", "Show what moves each place of the skin", ""),
            ("slice", "Show a slice through the body (distance to its skin)", ""),
        )
    ),
    *(
        Action(f"part.{part}", f"Show or hide the {words(part)}", "View/Parts", command=_toggle(part), on=_seen(part))
        for part in PARTS
    ),
    *(
        Action(f"level.{name}", f"Level: {name}", "View/Level", command=_fixed(commands.SetLevel(name)), on=_at_level(name))
        for name in LEVELS
    ),
    *(
        Action(f"layout.{name.lower()}", f"Layout: {name}", "View", key, effect=f"layout_{name.lower()}", separator=name == "Pose")
        for name, key in (("Pose", "F2"), ("Animate", "F3"), ("Training", "F4"))
    ),
    Action("layout.reset", "Reset layout", "View", effect="reset_layout"),
    Action("panels", "Show or hide the panels", "View", "Tab", effect="panels", separator=True),
    Action("full_screen", "Full screen", "View", "F11", effect="full_screen"),
    Action("stage", "Stage on or off", "View", command=lambda state: commands.SetStage("shown", not state.stage.shown),
            on=lambda state: state.stage.shown, separator=True),
    Action("stage.picture", "Background picture of the stage…", effect="stage_picture"),
    Action("play", "Play or pause", "Motion", "Space", effect="toggle_play", enabled=_can_play),
    Action("step.back", "Previous frame", "Motion", "Left", effect="step_back", enabled=_has_layers),
    Action("step.on", "Next frame", "Motion", "Right", effect="step_on", enabled=_has_layers),
    Action("frame.go_to", "Go to frame…", "Motion", "G", effect="go_to_frame", enabled=_has_layers),
    Action("key.set", "Set key", "Motion", "K", effect="set_key", separator=True),
    Action("key.camera", "Set key of the camera", "Motion", "Shift+K", effect="key_camera"),
    Action("record", "Record what is changed", "Motion", effect="record"),
    Action("motion.read", "How the motion was read…", "Motion", effect="read_motion", enabled=_has_motion, separator=True),
    Action("output", "Output window", "Live output", "F9", effect="output"),
    *(
        Action(f"output.{name}", f"Output over {what}", "Live output", effect=f"output_{name}", separator=name == "transparent")
        for name, what in (("transparent", "nothing (transparent)"), ("green", "key green"), ("black", "black"))
    ),
    *(
        Action(f"output.{name}", f"Output {size}", "Live output", effect=f"output_{name}", separator=name == "wide")
        for name, size in (("wide", "1280 × 720"), ("large", "1920 × 1080"), ("high", "1080 × 1920"))
    ),
    Action("output.camera", "Virtual camera", "Live output", effect="virtual_camera", separator=True),
    Action("tour", "Tour", "Help", effect="tour"),
    Action("palette", "Command palette", "Help", "Ctrl+P", effect="palette"),
    Action("shortcuts", "Keyboard shortcuts", "Help", "F1", effect="shortcuts"),
    Action("available", "What is available", "Help", effect="available"),
    *(_named("pose", name, commands.ApplyPose(name)) for name in POSES),
    *(_named("expression", name, commands.ApplyExpression(name)) for name in EXPRESSIONS),
    *(_named(f"{side} hand", name, commands.SetHandPose(side, name)) for side in ("left", "right") for name in HANDS),
)  # fmt: skip


def action(name: str) -> Action:
    """The action with that id."""
    return next(entry for entry in ACTIONS if entry.id == name)


def menu(name: str) -> tuple[Action, ...]:
    """The entries of a menu and of those in it, in order."""
    return tuple(entry for entry in ACTIONS if entry.menu.split("/")[0] == name)


def find(text: str) -> tuple[Action, ...]:
    """Actions with every word of `text` in their titles, those that begin with it first."""
    wanted = text.lower().split()
    found = [entry for entry in ACTIONS if all(word in entry.title.lower() for word in wanted)]
    return tuple(sorted(found, key=lambda entry: not entry.title.lower().startswith(text.lower())))
