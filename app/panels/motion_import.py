"""How the loaded motion was read: the table of `motion check` as a window, in which each guess can be changed.

It opens by itself over a motion with warnings, and from the Timeline. Every change reads the file again, in the background.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.session.actions import words
from avatarrex_studio.session.motion import Motion
from imgui_bundle import imgui

from avatarrex.signals.import_options import AXES, FLOORS, RESTS, SIDES, UNITS, ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion
from avatarrex.signals.joints import JOINT_NAMES

SIZE = (560.0, 640.0)
"""Points, at first."""
NARROWEST, NARROW = 250.0, 400.0
"""Points: its least width, and the one under which the reason of a guess stands below its value."""
GUESS, NONE = "guessed", "none (at rest)"
"""Entries of the lists beside the values."""
CHOICES = {"up": AXES, "forward": AXES, "unit": tuple(UNITS), "rest": RESTS, "floor": FLOORS, "side": SIDES, "hand_mean": ("flat",),
           "expressions": ()}  # fmt: skip
"""What each field of the options may be."""
A_FILE = "a file…"
"""The entry of what else may be a file."""
FILES = {
    "hand_mean": ("hand model", "Open a model with the mean hand"),
    "expressions": ("table", "Open a table of expressions"),
}
"""Fields that may name a file: its kind, and the title of the dialog."""
COLUMNS = (88.0, 150.0)
"""Points of what was decided and of its value."""
LABEL = 130.0
OPTIONS = re.compile(r" \(--[^()]*\)")
"""What a warning names for the command line."""


@runtime_checkable
class MotionReader(Protocol):
    """What reads motion files in the background."""

    @property
    def words(self) -> str:
        """What is read, empty where nothing is."""

    @property
    def rereading(self) -> bool:
        """Whether a loaded motion is read once more."""

    def motion(self, path: str) -> None:
        """Load a file."""

    def layer(self, path: str) -> None:
        """Put one over all layers."""

    def again(self, path: str, options: ImportOptions) -> None:
        """Read the loaded one once more, guesses replaced by `options`."""

    def cancel(self) -> None:
        """Give up what is being read."""


class MotionImport:
    """The window; closed at first."""

    def __init__(self, reader: MotionReader) -> None:
        self._reader = reader
        self.shown = self._focused = False
        self.files = FileDialog()
        self._picked: ImportOptions | None = None
        """With a file that was chosen, until it is read."""
        self._right = 0.0
        """Where the picture ended when it was drawn last."""
        self._seen: str | None = None
        """The path of the motion that was loaded last."""

    def open(self) -> None:
        """Show it."""
        self.shown = True

    def draw(self, studio: Studio) -> None:
        """Draw the window where it is open; have the motion read again where a guess was changed."""
        motion = studio.motion
        if motion is None:
            self.shown, self._seen = False, None
            return
        if motion.path != self._seen:
            self._seen = motion.path
            self.shown = bool(motion.imported.warnings)
        if not self.shown:
            return
        screen = imgui.get_main_viewport()
        corner, room = screen.work_pos + screen.work_size, screen.work_size
        right, before = _right_of_the_picture(), self._right
        self._right = right
        placed = imgui.Cond_.appearing if right == before else imgui.Cond_.always  # panels are laid out anew
        imgui.set_next_window_pos(
            (corner.x - 6, corner.y - 6), placed, (1.0, 1.0)
        )  # over the sliders: the picture stays free
        width = max(corner.x - right - 12, NARROWEST)
        imgui.set_next_window_size((min(SIZE[0], width), min(SIZE[1], room.y - 60)), placed)
        imgui.set_next_window_bg_alpha(1.0)
        opened, shown = imgui.begin("How the motion was read", True, imgui.WindowFlags_.no_docking)
        self.shown, self._focused = bool(shown), imgui.is_window_focused(imgui.FocusedFlags_.child_windows)
        chosen = self._content(motion) if opened else None
        self.files.draw()
        self._focused = self._focused and not self.files.is_open
        imgui.end()
        chosen, self._picked = self._picked or chosen, None
        if chosen is not None:
            self._reader.again(motion.path, chosen)

    def dismissed(self) -> bool:
        """Close the window where it has the focus and Esc was pressed, which while a text is edited ends that alone; whether it did."""
        edits, pressed = imgui.get_io().want_text_input, imgui.is_key_pressed(imgui.Key.escape, False)
        if edits or not (self.shown and self._focused and pressed):
            return False
        self.shown = self._focused = False
        return True

    def _content(self, motion: Motion) -> ImportOptions | None:
        """The options after a change; None without one. While the file is read again nothing can be changed."""
        imported, busy = motion.imported, self._reader.rereading
        widgets.paragraph(imported.sequence.name, theme.TEXT)
        if busy:
            self._progress()
        imgui.begin_disabled(busy)
        chosen = self._table(motion)
        imgui.end_disabled()
        return chosen

    def _progress(self) -> None:
        """What is read, and what gives it up."""
        words = self._reader.words
        widgets.caption(words[:1].upper() + words[1:], theme.TEXT)
        imgui.progress_bar(-imgui.get_time(), (widgets.room() - 96, 0), "")
        imgui.same_line()
        if imgui.button("Cancel###cancel.again", (-1, 0)):
            self._reader.cancel()

    def _table(self, motion: Motion) -> ImportOptions | None:
        """Warnings, guesses, joints; the options after a change."""
        imported = motion.imported
        for text in imported.warnings:
            widgets.paragraph(without_options(text), theme.WARNING)
        if not imported.warnings:
            widgets.caption("Nothing looks wrong.")
        imgui.spacing()
        chosen = self._guesses(imported)
        if imported.errors:
            angles = ", ".join(f"{part} {largest:.1f}°" for part, (_, largest) in imported.errors.items())
            widgets.paragraph(f"Directions off from the file's own at most: {angles}")
        if imported.skeleton and imgui.collapsing_header("Joints"):
            chosen = self._joints(motion) or chosen
        return chosen

    def _guesses(self, imported: ImportedMotion) -> ImportOptions | None:
        """The table; the options after a change."""
        chosen = None
        narrow = widgets.room() < NARROW
        flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
        if not imgui.begin_table("guesses", 2 if narrow else 3, flags):
            return None
        for title, width in zip(("what", "value"), COLUMNS[: 1 if narrow else 2]):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_fixed, width)
        imgui.table_setup_column("why", imgui.TableColumnFlags_.width_stretch)
        for guess in imported.guesses:
            imgui.table_next_column()
            imgui.align_text_to_frame_padding()
            widgets.caption(guess.what.capitalize())
            imgui.table_next_column()
            chosen = self._value(guess, imported) or chosen
            if not narrow:
                imgui.table_next_column()
                imgui.align_text_to_frame_padding()
            widgets.paragraph(guess.why)
        imgui.end_table()
        return chosen

    def _value(self, guess: Guess, imported: ImportedMotion) -> ImportOptions | None:
        """A guess as a list to choose from, a number, a box to tick, or its words; the options after a change."""
        options = imported.options
        widgets.fill()
        if guess.option in CHOICES:
            picked = _choice(guess, options)
            if picked == A_FILE:
                kind, title = FILES[guess.option]
                self.files.open(kind, title, lambda path: self._take(_with(options, guess.option, path)))
            return None if picked in (None, A_FILE) else _with(options, guess.option, "" if picked == GUESS else picked)
        if guess.option == "fps":
            rate, enter = imported.sequence.fps, imgui.InputTextFlags_.enter_returns_true
            changed, typed = imgui.input_double("##fps", rate, 0, 0, "%.12g a second", enter)
            return replace(options, fps=typed) if changed and 0 < typed <= 1000 else None
        if guess.option == "lock_feet":
            changed, locked = imgui.checkbox("Stay where they stand##lock_feet", options.lock_feet)
            return replace(options, lock_feet=locked) if changed else None
        imgui.align_text_to_frame_padding()
        widgets.paragraph(guess.value, theme.TEXT)
        return None

    def _take(self, options: ImportOptions) -> None:
        self._picked = options

    def _joints(self, motion: Motion) -> ImportOptions | None:
        """The file's joint of each of ours, but the fingers'."""
        chosen, imported = None, motion.imported
        assert imported.skeleton is not None
        names = [GUESS, NONE, *(name for name in imported.skeleton.names if not name.endswith(" end"))]
        for ours in JOINT_NAMES[:25]:
            widgets.label(words(ours), LABEL, ours in dict(imported.options.joints))
            theirs = imported.skeleton.mapped.get(ours, NONE)
            picked = widgets.choice(f"##joint.{ours}", names, theirs, theirs)
            if picked is not None:
                kept = {name: value for name, value in imported.options.joints if name != ours}
                said = {} if picked == GUESS else {ours: "" if picked == NONE else picked}
                chosen = replace(imported.options, joints=tuple({**kept, **said}.items()))
        return chosen


def _right_of_the_picture() -> float:
    """Where the viewport ends; the left of the screen while there is none."""
    viewport = imgui.internal.find_window_by_name("Viewport")
    return float(viewport.pos.x + viewport.size.x) if viewport is not None else 0.0


def without_options(text: str) -> str:
    """A warning without what the command line would want for it: here the table has a list for that."""
    return OPTIONS.sub("", text)


def _choice(guess: Guess, options: ImportOptions) -> str | None:
    """A list of what a field may be; what was picked."""
    allowed = [name for name in CHOICES[guess.option] if guess.option != "forward" or name[1] != options.up[1:]]
    files = (A_FILE,) if guess.option in FILES else ()
    picked = widgets.choice(
        f"##{guess.option}", (GUESS, *allowed, *files), guess.value, getattr(options, guess.option) or GUESS
    )
    widgets.tooltip(guess.value)
    return picked


def _with(options: ImportOptions, field: str, value: str) -> ImportOptions:
    """The options after a choice; an axis forward that is up now is guessed."""
    said: dict[str, Any] = {field: value}
    if field == "up" and options.forward[1:] == value[1:]:
        said["forward"] = ""
    return replace(options, **said)
