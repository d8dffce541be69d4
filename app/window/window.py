"""The window: panels around a viewport, one OpenGL context for the interface and the surface.

Each frame: the panels draw and return commands, the studio draws the surface where something changed and takes what the exact
engine sent, both go into the texture that the viewport shows. It waits for nothing; while nothing changes the loop sleeps on events.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.exact import ExactEngine
from avatarrex_studio.engine.live import LiveSurface
from avatarrex_studio.engine.pages import Resting, give_pages
from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.jobs.distilling import Distilling
from avatarrex_studio.jobs.export_order import Make
from avatarrex_studio.jobs.opening import read_any
from avatarrex_studio.jobs.training_process import TrainingProcesses
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import (
    camera,
    curves,
    cut_card,
    keys,
    menu,
    opening_progress,
    performance,
    render,
    scene,
    status,
    theme,
)
from avatarrex_studio.panels.availability import TITLE, Availability
from avatarrex_studio.panels.console import ConsolePanel
from avatarrex_studio.panels.face import face_panel
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.panels.hands import HandPanel
from avatarrex_studio.panels.joints import body_panel
from avatarrex_studio.panels.palette import Palette
from avatarrex_studio.panels.poses import PosesPanel
from avatarrex_studio.panels.questions import Question, Questions, nothing
from avatarrex_studio.panels.timeline import TimelinePanel
from avatarrex_studio.panels.toasts import Toasts
from avatarrex_studio.panels.training import TrainingPanel
from avatarrex_studio.panels.viewport import ViewportPanel
from avatarrex_studio.session.actions import ACTIONS, Action
from avatarrex_studio.session.autosave import Autosave
from avatarrex_studio.session.commands import Command, Select, SetSignals, SetStage, ZoomBy
from avatarrex_studio.session.figures import standing
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.notice import refusals_logged
from avatarrex_studio.session.state import StudioState
from avatarrex_studio.session.timeline_commands import SetFrame
from avatarrex_studio.window.context_loss import ContextLoss
from avatarrex_studio.window.docking import BARE, LAYOUTS, docking, show_panel, toggle_panels
from avatarrex_studio.window.exporting import Exports
from avatarrex_studio.window.extent import USUAL, first_size, keep_usable
from avatarrex_studio.window.full_screen import FullScreen
from avatarrex_studio.window.guard import COPY, Failure, Guard
from avatarrex_studio.window.leaving import Leaving
from avatarrex_studio.window.opening import Opening
from avatarrex_studio.window.output import GROUNDS, SIZES, Output
from avatarrex_studio.window.own_surface import OwnSurface
from avatarrex_studio.window.personal import Personal
from avatarrex_studio.window.quick_input import QuickInput
from avatarrex_studio.window.room import Room
from avatarrex_studio.window.runner import open_gl, runner_params
from avatarrex_studio.window.screen import Screen
from imgui_bundle import hello_imgui, imgui, immapp
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

from avatarrex.files.gate import what_is
from avatarrex.gl.context import REQUIRED, renderer_name
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import mirror
from avatarrex.stage.picture import read_picture, stamp
from avatarrex.stage.stage import PICTURE, Stage
from avatarrex.templates.parts import HANDS

log = logging.getLogger(__name__)
WARM_UP = 3
"""Interface frames before the first picture: the viewport has its size then."""
FPS = 60
"""Interface frames a second at most, where the screen does not say."""
READING_FPS, TYPING_FPS, WATCHING_FPS, IDLE_FPS = 20, 4, 1, 0.15
"""While an avatar is read, while a text has a cursor that blinks, while another process or a sender is watched, and while nothing
moves; input and a picture that comes wake the loop. Such a frame takes 70 to 110 ms of processor time where OpenGL is software."""
WHEEL_PAUSE = 0.5
"""Seconds between wheel notches that end one undo step."""


class Window:
    """The loop's callbacks."""

    def __init__(
        self, studio: Studio, runs: str | Path = "runs", device: str = "cpu", make: Make | None = None
    ) -> None:
        """`runs`: the folder of the trainings that the Training tab shows; it trains on `device`. `make()` makes the engine that exports."""
        self.studio = studio
        self.training = TrainingPanel(Watcher(runs), TrainingProcesses(device=device))
        self.opening = Opening(studio, self.training, self._replaced, self._deciding)
        self.timeline = TimelinePanel(self.opening)
        self.viewport, self.console = ViewportPanel(), ConsolePanel()
        self.body, self.left, self.right = body_panel(), HandPanel("left"), HandPanel("right")
        self.face, self.poses, self.palette, self.files = face_panel(), PosesPanel(), Palette(), FileDialog()
        self._sliders = {"Body": self.body, "Left hand": self.left, "Right hand": self.right, "Face": self.face}
        self.screen, self.questions, self.autosave = Screen(), Questions(), Autosave()
        self.toasts, self.guard = Toasts(self._refused), Guard(self._failed)
        self.leaving = Leaving(studio, self.training.processes, self.questions, self.autosave)
        self.leaving.offer()
        self.distilling = Distilling(device=device)
        self.own_surface = OwnSurface(studio.avatars, self.distilling)
        self.output, self.available = Output(), Availability()
        self.personal = Personal(studio, self.viewport, self.palette)
        self.exports = Exports(studio, self.questions, make or partial(Engine, device=device))
        self.first_picture: Callable[[], None] = nothing
        """Called once, when there is something to see."""
        self._resting, self.loss, self._room, self._input = Resting(), ContextLoss(), Room(), QuickInput()
        self.anew = False  # whether the window that is being closed is opened anew, for its context was lost
        self._frames, self._gesture, self._wheel = 0, 0, (0.0, 0)
        self._keys_free = True
        """Whether keys were shortcuts when this frame began: what Esc closes does not pass it on."""
        self._chords = [(keys.chord(entry.shortcut), entry) for entry in ACTIONS if entry.shortcut]
        self._effects: dict[str, Callable[[], None]] = {
            "undo": studio.undo, "redo": studio.redo, "toggle_play": studio.toggle_play,
            "step_back": lambda: studio.step_by(-1), "step_on": lambda: studio.step_by(1),
            "read_motion": self.timeline.reading.open, "set_key": studio.set_key, "key_camera": studio.key_camera,
            "record": studio.toggle_recording, "go_to_frame": self.timeline.go_to,
            "open": lambda: self.files.open("any", "Open", self.opening.open),
            "add_figure": lambda: self.files.open("any", "Add an avatar", self.opening.add),
            "output": lambda: self.output.toggle(self.screen.open()), "virtual_camera": self.output.camera.toggle,
            **{f"output_{name}": partial(setattr, self.output, "ground", name) for name in GROUNDS},
            **{f"output_{name}": partial(self.output.resize, name) for name in SIZES},
            "export": lambda: self.exports.open(self.viewport.size), "import_capture": self.opening.import_capture,
            "save_session": self._save, "save_session_as": self._save_as, "copy_pose": self._copy,
            "paste_pose": self._paste, "paste_flipped": partial(self._paste, flipped=True),
            "screenshot": self._screenshot, "look_at_camera": studio.look_at_camera, "frame_face": studio.frame_face,
            "whole_person": lambda: studio.frame_person(self.viewport.size),
            "palette": self.palette.open, "shortcuts": self.palette.open_sheet, "reset_layout": self._reset_layout,
            "full_screen": FullScreen().toggle, "panels": toggle_panels,
            **{f"layout_{name.lower()}": partial(hello_imgui.switch_layout, name) for name in LAYOUTS},
            "preferences": self.personal.dialog.open, "tour": self.personal.tour.start, "available": self.available.open,
            "quit": self._quit, "stage_picture": self._stage_picture, **{f"frame_{hand}": partial(studio.frame_hand, hand) for hand in HANDS},
        }  # fmt: skip

    def params(self, size: tuple[int, int] = USUAL, remember: bool = True) -> hello_imgui.RunnerParams:
        """What the toolkit needs to run this window; `remember` keeps the layout between runs."""
        self._frames, self.anew = 0, False
        params = runner_params("AvatarReX Studio", "avatarrex-studio.ini", size, remember)
        inner = params.imgui_window_params
        inner.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        inner.show_menu_bar = inner.show_status_bar = True
        inner.show_menu_app = inner.show_menu_view = inner.show_status_fps = False
        inner.remember_status_bar_settings = False
        inner.background_color = theme.vec4(theme.PANEL)
        params.fps_idling.time_active_after_last_event = 0.5
        params.fps_idling.fps_max = FPS
        params.renderer_backend_options.open_gl_options = open_gl(REQUIRED)
        calls = params.callbacks
        calls.setup_imgui_config = _configure
        for name, place, call in (
            ("show_menus", "The menu", self._menus), ("post_new_frame", "The interface's scale", self._begin),
            ("post_init", "Opening the window", self._opened), ("show_status", "The status bar", self._status),
        ):  # fmt: skip
            setattr(calls, name, partial(self.guard.run, place, call))
        calls.pre_new_frame, calls.before_imgui_render, calls.show_gui = self._prepare, self._render, self._over
        calls.confirm_exit = lambda: self.guard.run("Closing", self._may_close) is not False
        calls.before_exit = self._close
        params.docking_params, *params.alternative_docking_layouts = docking(self._panels(), size[0])
        return params

    def _panels(self) -> dict[str, Callable[[], None]]:
        """What draws each panel, by title."""

        def state() -> StudioState:
            return self.studio.state

        drawn: dict[str, Callable[[], Iterable[Command | Action] | None]] = {
            "Viewport": self._viewport,
            "Body": lambda: self.body.draw(state()),
            "Left hand": lambda: self.left.draw(state()),
            "Right hand": lambda: self.right.draw(state()),
            "Face": lambda: self.face.draw(state()),
            "Poses": lambda: self.poses.draw(state()),
            "Training": self.training.draw,
            "Performance": lambda: performance.draw(self.studio),
            "Camera": lambda: camera.draw(state()),
            "Render": lambda: render.draw(state()),
            "Scene": lambda: scene.draw(state(), self.opening.recent, self.opening.add),
            "Timeline": self._timeline,
            "Console": self.console.draw,
        }
        guarded = {title: partial(self.guard.panel, title, partial(self._show, draw)) for title, draw in drawn.items()}
        return {**guarded, BARE: partial(self.guard.run, BARE, partial(self._show, drawn[BARE]))}

    def _viewport(self) -> Iterator[Command]:
        """The picture from edge to edge, without a tab of its own."""
        theme.window_background(1.0)  # the first panel that is drawn after the space that all are docked in
        kind = imgui.WindowClass()
        kind.dock_node_flags_override_set = imgui.internal.DockNodeFlagsPrivate_.no_tab_bar
        imgui.set_next_window_class(kind)
        imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(0, 0))
        flags = (
            imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse | imgui.WindowFlags_.no_background
        )
        shown, _ = imgui.begin("Viewport", None, flags)
        imgui.pop_style_var()
        for command in self.viewport.draw(self.studio, self.screen.shown) if shown else ():
            yield command
            if isinstance(command, Select) and command.name:
                self._reveal(command.name)
        imgui.end()

    def _reveal(self, part: str) -> None:
        """Show the sliders of a joint or of a region of the face."""
        for title, panel in self._sliders.items():
            if panel.reveal(part):
                hello_imgui.get_runner_params().docking_params.focus_dockable_window(title)
                return

    def _show(self, draw: Callable[[], Iterable[Command | Action] | None]) -> None:
        self._collect(draw())

    def _collect(self, commands: Iterable[Command | Action] | None) -> None:
        """Apply a panel's commands; a drag is one undo step, and so is a turn of the wheel."""
        for command in commands or ():
            if isinstance(command, Action):
                self._run(command)
                continue
            gesture: tuple[str, int] = ("drag", self._gesture)
            if isinstance(command, ZoomBy):
                last, number = self._wheel
                number += time.monotonic() - last > WHEEL_PAUSE
                self._wheel = (time.monotonic(), number)
                gesture = ("wheel", number)
            self.guard.run(type(command).__name__, partial(self.studio.do, command, gesture))

    def _status(self) -> None:
        context = self.screen.context
        status.draw(
            self.studio,
            renderer_name(context) if context else "none",
            self.opening.words or self.exports.words or self.own_surface.words,
            self.studio.listening.words,
        )

    def _timeline(self) -> Iterator[Command]:
        for command in self.timeline.draw(self.studio):
            if isinstance(command, SetFrame):
                self.studio.playback.playing = False
            yield command

    def _over(self) -> None:
        """What lies over the panels, and the keys. One that fails stops no other: what failed is told by another one."""
        for place, draw in (
            ("Commands", lambda: self._run(self.palette.draw(self.studio.journal))), ("The file dialog", self.files.draw),
            ("How the motion was read", lambda: self.timeline.reading.draw(self.studio)), (TITLE, self.available.draw),
            ("A question", self.questions.draw), ("Preferences and tour", self.personal.draw), ("Messages", self._toasts),
            ("Keys", self._shortcuts),
        ):  # fmt: skip
            self.guard.run(place, draw)

    def _shortcuts(self) -> None:
        """Those that were pressed; what a drag has taken stays what it is until the button is let go."""
        closed = keys.close_topmost() or self.timeline.reading.dismissed()
        if not closed and keys.free() and self._keys_free and not imgui.is_any_mouse_down():
            for chord, entry in self._chords:
                if keys.pressed(chord) and entry.enabled(self.studio.journal):
                    self._run(entry)
        if not (imgui.is_any_item_active() or imgui.is_any_mouse_down()):
            self._gesture += 1

    def _run(self, entry: Action | None) -> None:
        if entry is None:
            return
        if entry.command:
            command = entry.command
            self.guard.run(entry.title, lambda: self.studio.do(command(self.studio.state)))
        elif entry.effect:
            self.guard.run(entry.title, self._effects[entry.effect])

    def _prepare(self) -> None:
        """Before the interface's frame."""
        self.guard.run("Pictures of trainings", lambda: self.training.upload(self.screen.open()))
        self.guard.run("Preferences", self.personal.prepare)
        theme.window_background(0.0)
        self._keys_free = keys.free()
        imgui.get_current_context().config_nav_enable_tabbing = not self._keys_free  # else Tab hides the panels
        if self._frames < WARM_UP:
            imgui.get_io().clear_events_queue()  # clicks and keys that came before there was anything to see

    def _begin(self) -> None:
        """The interface's frame has begun; nothing is laid out yet."""
        self.personal.scale.apply()
        self._room.share()
        self._input.begin_frame()

    def _render(self) -> None:
        """Show what changed. After the panels, so that a picture follows the mouse in the same frame."""
        self.guard.run("The panels' sizes", self._room.give_back)
        self._frames += 1
        if self._frames > WARM_UP:
            if self.loss.found(self.guard.run("The picture", self._picture) is True):
                self._lost()
            self.guard.run("The avatar's own surface", self._own_surfaces)
            self.guard.run("Opening", self._open_what_was_read)
            self.guard.run("Face", lambda: self.face.follow(self.studio.avatars.ready(self.studio.state.avatar)))
        self.guard.run("Autosave", lambda: self.autosave.tend(self.studio.journal))
        self.guard.run("Waiting", self._idle)

    def _picture(self) -> bool:
        """Draw what is to be seen; True."""
        context = self.screen.open()
        if context.version_code < REQUIRED:
            self.studio.live = None
        new = self.studio.tick(self.viewport.size)
        self.screen.show(self.studio, new)
        if self.screen.shown:
            self.first_picture()
            self.first_picture = nothing
        self.output.show(self.screen.layers, context, new)
        return True

    def _lost(self) -> None:
        """The OpenGL context is gone: the work is kept, and the window ends, to be opened anew unless that was just done."""
        self.autosave.keep(self.studio.journal)
        if self.loss.given_up:
            log.error(
                "The graphics driver took the window away again: the studio ends. Your work is offered at its next start."
            )
        else:
            log.warning("The graphics driver took the window away: it was opened anew, with all that was open.")
            self.anew = True
        self._exit()

    def _own_surfaces(self) -> None:
        self.own_surface.tend(*(figure.avatar for figure in self.studio.state.figures))

    def _idle(self) -> None:
        """Thumbnails while nothing moves; how often the interface is drawn then."""
        context = self.screen.open()
        idling = hello_imgui.get_runner_params().fps_idling
        idling.enable_idling = not self.studio.moving and self._frames > WARM_UP + 1
        shown = self.studio.avatars.ready(self.studio.state.avatar) if self.studio.live else None
        self.poses.cards.tend(context, shown, not self.studio.moving)
        waiting = (
            self.exports.busy
            or self.studio.avatars.reading
            or self.opening.busy
            or self.poses.cards.waiting
            or self.toasts.moving
        )
        idling.fps_idle = READING_FPS if waiting else self._resting_fps()
        self._resting.tend(waiting or self.studio.moving or imgui.is_any_mouse_down())
        if context.screen:
            context.screen.use()

    def _resting_fps(self) -> float:
        """Frames a second of an interface in which nothing moves."""
        if imgui.get_io().want_text_input:
            return TYPING_FPS
        others = self.training.at_work or self.own_surface.words or self.studio.listening.words
        return WATCHING_FPS if others else IDLE_FPS

    def _copy(self) -> None:
        imgui.set_clipboard_text(json.dumps(self.studio.state.signals.to_json()))

    def _paste(self, flipped: bool = False) -> None:
        with refusals_logged():
            signals = Signals.from_json(imgui.get_clipboard_text(), "clipboard")
            self.studio.do(SetSignals(mirror(signals) if flipped else signals))

    def _stage_picture(self) -> None:
        """Choose the picture behind the figure; one that cannot be read is said and changes nothing."""

        def chosen(path: str) -> None:
            with refusals_logged(opening=path):
                read_picture(stamp(path))
                for name, value in {"picture": path, "backdrop": PICTURE, "shown": True}.items():
                    self.studio.do(SetStage(name, value), ("stage picture", self._gesture))

        self.files.open("picture", "Background picture", chosen)

    def _screenshot(self) -> None:
        path = Path.cwd() / time.strftime("avatarrex-%Y%m%d-%H%M%S.png")
        self.studio.save_image(path, self.viewport.size)

    def _reset_layout(self) -> None:
        hello_imgui.get_runner_params().docking_params.layout_reset = True

    def _quit(self) -> None:
        if self._may_close():
            self._exit()

    def _exit(self) -> None:
        hello_imgui.get_runner_params().app_shall_exit = True

    def _close(self) -> None:
        self._drop()
        if self.anew:
            return
        parts = (
            self.training,
            self.distilling,
            self.opening,
            self.exports,
            self.studio,
            *(() if self.loss.given_up else (self.autosave,)),
        )
        for part in parts:  # each ends, whatever becomes of the others
            self.guard.run(f"Closing ({type(part).__name__})", part.close)

    def _drop(self) -> None:
        """Give up what belongs to the window's context, which is current."""
        for place, drop in {
            "surface": self.studio.forget_surface, "cards": self.poses.cards.close, "samples": self.training.plots.samples.close,
            "curves": curves.close, "output": self.output.close, "screen": self.screen.close,
        }.items():  # fmt: skip
            self.guard.run(f"Closing ({place})", drop)

    def _may_close(self) -> bool:
        """Whether the window can close at once; else a question is on the screen."""
        return self.exports.may_close(self._exit) and self.leaving.now(self._save, self._exit)

    def _save(self, then: Callable[[], None] = nothing) -> None:
        """Write the session to its file, or to one that is chosen; `then` comes after it."""
        path = self.studio.journal.path
        if path is None:
            self._save_as(then)
        elif self.studio.save_session(path):
            then()

    def _replaced(self, then: Callable[[], None]) -> None:
        """Show another session by `then`, once it is decided what becomes of unsaved work."""
        if self.leaving.saved(self._save, then):
            then()

    def _deciding(self) -> bool:
        """Whether a question, or where the session is saved, waits for its answer."""
        return bool(self.questions.waiting) or self.files.is_open

    def _save_as(self, then: Callable[[], None] = nothing) -> None:
        def write(path: str) -> None:
            if self.studio.save_session(path):
                self.opening.recent.add(path)
                then()

        def chosen(path: str) -> None:
            if what_is(path) != "a file":  # what is no place for one is refused with its reason
                write(path)
                return
            answers = {"Overwrite": lambda: write(path), "Other name…": lambda: self._save_as(then), "Cancel": nothing}
            self.questions.put(Question("Overwrite the file?", f"{path} is there already.", answers))

        path = self.studio.journal.path
        folder = Path(path).absolute().parent if path else None
        self.files.save("session", "Save the session", chosen, folder)

    def _refused(self, opening: str, text: str) -> None:
        """A file that cannot be opened."""
        answers = {"Close": nothing, "Open another…": self._effects["open"]}
        self.questions.put(Question(f"{Path(opening).name} cannot be opened", text, answers))

    def _failed(self, failure: Failure) -> None:
        """A fault of ours."""
        copy = partial(imgui.set_clipboard_text, failure.details)
        self.questions.put(Question(f"{failure.place} failed", failure.text, {"Close": nothing, COPY: copy}))

    def _toasts(self) -> None:
        """What lies over the viewport's edges: where the slice is, toasts, and how far an export is."""
        low = imgui.get_main_viewport().work_pos
        high = low + imgui.get_main_viewport().work_size
        window = imgui.internal.find_window_by_name("Viewport")
        if window is not None:
            low, high = window.pos, window.pos + window.size
        self._collect(cut_card.draw(self.studio, (low.x, low.y), (high.x, high.y)))
        self.exports.draw((low.x, low.y), (high.x, high.y))
        if self.opening.slow and opening_progress.draw(self.opening.words, (low.x, low.y), (high.x, high.y)):
            self.opening.cancel()
        if self.toasts.draw((low.x, low.y), (high.x, high.y)):
            show_panel("Console")

    def _menus(self) -> None:
        chosen = menu.draw(self.studio.journal, self.opening.recent)
        self.personal.draw_hint()
        if isinstance(chosen, str):
            self.opening.open(chosen)
        else:
            self._run(chosen)

    def _opened(self) -> None:
        """The window is there: files that are dropped on it are opened, and it is as large as it should be."""
        self.personal.open()
        keep_usable(self.personal.scale.factor)
        self.loss.open()
        self._input.open()
        import glfw  # after imgui_bundle, which brings its own library

        # the stub has GLFW's own arguments, Python's callback gets the window and a list
        glfw.set_drop_callback(glfw_window_hello_imgui(), self.opening.dropped)  # type: ignore[arg-type]

    def _open_what_was_read(self) -> None:
        self.opening.tend()
        if self.opening.tab:
            show_panel(self.opening.tab)
            self.opening.tab = ""


def prepared(source: str, avatars: Avatars, device: str = "cpu") -> Window:
    """A window on anything that `Opening` opens, networks on `device`, to be run by `run`. Raises `InputError`."""
    exact = ExactEngine(partial(Engine, device=device), later=True)
    opened = read_any(source, avatars.read)
    journal = opened.journal or Journal(start(next(iter(opened.avatars), "default")))
    window = Window(Studio(exact, avatars, journal, LiveSurface()), device=device)
    logging.basicConfig(
        level=logging.INFO, format="%(message)s", handlers=[window.console, window.toasts, logging.StreamHandler()]
    )
    log.info("AvatarReX Studio. F1 shows the keys, Ctrl+P finds every command.")
    window.first_picture = exact.begin
    window.opening.take(opened)
    if source == "default":
        window.personal.greet()
    return window


def run(window: Window) -> int:
    """Run the window until it is closed; the exit code: 1 where its OpenGL context was lost for good."""
    import glfw  # after imgui_bundle, which brings its own library

    give_pages()
    arrived = glfw.post_empty_event
    if isinstance(window.studio.pictures.exact, ExactEngine):
        window.studio.pictures.exact.arrived = arrived
    window.opening.arrived = arrived
    window.exports.process.arrived = window.studio.listening.arrived = arrived
    while True:
        window.loss.ask()
        immapp.run(window.params(first_size()))
        if not window.anew:
            return int(window.loss.given_up)


def start(avatar: str = "default") -> StudioState:
    """The state that a new window opens with: standing on a stage, hands and face relaxed."""
    return StudioState(avatar=avatar, signals=standing(), stage=Stage(shown=True))


def _configure() -> None:
    """Docking, no keyboard navigation: the keys are the studio's."""
    io = imgui.get_io()
    io.config_flags = imgui.ConfigFlags_.docking_enable
    io.config_windows_move_from_title_bar_only = True
