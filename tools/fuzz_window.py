"""A user without aim: random mouse, keys, texts, commands, files and sizes in the true window, until the time is over.

    python tools/fuzz_window.py [--seed N] [--seconds S] [--size WxH] [--folder FOLDER]

Opens the window on the default avatar on an Xvfb of its own, in a folder of its own, with files of every kind, good and broken. What
fails is printed with the seed and the actions before it (all are in `actions.txt` of the folder, also after a crash); so is memory over
time, and at the end whether the window still does what it is told. A seed repeats the actions; what they meet depends on the machine's
speed, too. No training starts: what the window would run as a verb is replaced by a program that ends at once. Exit code 1 after a failure.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import logging
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import TextIO

import numpy as np
from avatarrex_studio.session.actions import ACTIONS, Action, action
from avatarrex_studio.window.docking import PLACES
from avatarrex_studio.window.window import Window
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

KEYS = [
    *(getattr(imgui.Key, letter) for letter in "abcdefghijklmnopqrstuvwxyz"), *(getattr(imgui.Key, f"_{k}") for k in range(10)),
    *(getattr(imgui.Key, f"f{k}") for k in range(1, 13)), imgui.Key.tab, imgui.Key.enter, imgui.Key.escape, imgui.Key.space,
    imgui.Key.delete, imgui.Key.backspace, imgui.Key.home, imgui.Key.end, imgui.Key.left_arrow, imgui.Key.right_arrow,
    imgui.Key.up_arrow, imgui.Key.down_arrow,
]  # fmt: skip
MODIFIERS = (imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key.mod_alt)
TEXTS = (
    "0", "-1", "1e999", "nan", "45", "3.5", "pose squat", "level", "a b", "../x", "ä€😀", "%s%n", "##x", "x" * 300, "/", "~", "12,5", "mine",
)  # fmt: skip
SIZES = ((320, 240), (900, 600), (1280, 800), (1920, 1080), (640, 1000), (1500, 420))
LEAVES = ("quit",)
"""Ids of actions that are not done: the fuzzer itself ends the window."""
SLOW = 8.0
"""Seconds between two frames that count as a window that does not answer."""
WARM = 5
"""Frames before the first action."""
EVERY = 5.0
"""Seconds between two readings of memory."""
KEPT = 40
"""Actions that are printed before a failure."""
HARMLESS = (sys.executable, "-c", "print('nothing was done')")
"""Instead of verbs of the command line."""


@dataclass
class Report:
    """What was found."""

    seed: int
    failures: list[str] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    """Seconds since the beginning, MiB of the window's process."""
    actions: int = 0
    frames: int = 0
    longest: float = 0.0
    """Seconds between two frames."""
    answers: bool = False
    """Whether the window did at the end what it was told."""

    @property
    def growth(self) -> float:
        """MiB more at the end than in the middle: medians of the last fifth and of the one in the middle."""
        values = [value for _, value in self.memory]
        fifth = max(len(values) // 5, 1)
        middle = values[2 * fifth : 3 * fifth] or values
        return float(np.median(values[-fifth:]) - np.median(middle)) if values else 0.0


class Fuzz(logging.Handler):
    """Drives a window by events of the toolkit, one small action a frame."""

    def __init__(self, window: Window, seed: int, seconds: float, folder: Path) -> None:
        super().__init__(logging.ERROR)
        self.window, self.report, self._random = window, Report(seed), random.Random(seed)
        self._folder, self._seconds = folder, seconds
        self._files = sorted((folder / "files").iterdir())
        self._last: deque[str] = deque(maxlen=KEPT)
        self._queue: deque[Callable[[], None]] = deque()
        self._trail: TextIO = (folder / "actions.txt").open("w")
        self._begun = self._frame = self._read = time.monotonic()
        self._spent = 0.0
        """Processor time of the process at the last frame."""
        self._queued = _queued()
        signal.signal(signal.SIGCONT, self._continued)
        self._ending = 0
        self._actions = [entry for entry in ACTIONS if entry.id not in LEAVES]
        self._kinds = {
            self._mouse: 30, self._drag: 14, self._wheel: 6, self._key: 20, self._type: 8, self._do: 14, self._tab: 8,
            self._open: 2, self._resize: 1, self._clipboard: 1, self._escape: 6, self._vanish: 0.3, self._kill: 0.1,
        }  # fmt: skip
        tell = window.guard._tell
        window.guard._tell = lambda failure: (self._failed(failure.details), tell(failure))[1]
        window._exit = lambda: self._note("(would leave)")  # type: ignore[method-assign]
        for runs_verbs in (window.training.processes, window.training.tasks, window.distilling):
            runs_verbs._command = HARMLESS

    def params(self, size: tuple[int, int]) -> hello_imgui.RunnerParams:
        """The window's, with the fuzzer in its loop."""
        params = self.window.params(size, remember=False)
        prepare, render = params.callbacks.pre_new_frame, params.callbacks.before_imgui_render

        def awake() -> None:
            render()
            params.fps_idling.enable_idling = False

        params.callbacks.pre_new_frame = lambda: (prepare(), self._step())[0]
        params.callbacks.before_imgui_render = awake
        return params

    def emit(self, record: logging.LogRecord) -> None:
        """A fault that was caught somewhere and logged with its trace."""
        if record.exc_info:
            self._failed(logging.Formatter("%(message)s").format(record))

    def _continued(self, *_: object) -> None:
        """Somebody had stopped the process: that is no fault of the window."""
        self._frame = time.monotonic()

    def close(self) -> None:
        """Write all that was done."""
        signal.signal(signal.SIGCONT, signal.SIG_DFL)
        self._trail.close()
        super().close()

    def _failed(self, text: str) -> None:
        trail = "\n".join(f"    {line}" for line in self._last)
        self.report.failures.append(f"seed {self.report.seed}, action {self.report.actions}, after\n{trail}\n{text}")
        self._trail.write(f"FAILED\n{text}\n")
        self._trail.flush()

    def _note(self, text: str) -> None:
        self._last.append(text)
        self._trail.write(f"{time.monotonic() - self._begun:.1f} s, {self.report.actions}: {text}\n")
        self._trail.flush()

    def _step(self) -> None:
        """One frame."""
        now = time.monotonic()
        self.report.frames += 1
        if self.window._frames < WARM:
            self._begun = self._frame = now
            return
        self.report.longest = max(self.report.longest, now - self._frame)
        spent, queued = time.process_time(), _queued()
        if now - self._frame - (queued - self._queued) > SLOW:
            self._failed(f"no frame for {now - self._frame:.1f} s, {spent - self._spent:.1f} s of them at work")
        self._frame, self._spent, self._queued = now, spent, queued
        if now - self._read > EVERY:
            self._read = now
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            self.report.memory.append((now - self._begun, pages * os.sysconf("SC_PAGE_SIZE") / 2**20))
        if now - self._begun > self._seconds:
            self._end()
        elif self._queue:
            self._queue.popleft()()
        else:
            self.report.actions += 1
            self._random.choices(list(self._kinds), list(self._kinds.values()))[0]()

    def _end(self) -> None:
        """Everything closed by Esc and nothing pressed, does the window still answer?"""
        io = imgui.get_io()
        if self._ending == 0:
            self._queue.clear()
            for button in range(3):
                io.add_mouse_button_event(button, False)
            for key in (*KEYS, *MODIFIERS):
                io.add_key_event(key, False)
            io.add_mouse_pos_event(-1, -1)
            self.window.studio.playback.playing = False
        elif self._ending < 30:
            io.add_key_event(imgui.Key.escape, self._ending % 2 == 1)
        elif self._ending == 32:
            self.window.studio.do(action("view.front").command(self.window.studio.state))  # type: ignore[misc]
            self._press(imgui.Key._3)
            self._queue.popleft()()
        elif self._ending == 35:
            while self._queue:
                self._queue.popleft()()
        elif self._ending == 39:
            self.report.answers = self.window.studio.state.view.azimuth == -90.0
            if not self.report.answers:
                waiting = [question.title for question in self.window.questions.waiting]
                self._failed(f"the window does not answer a key any more; questions: {waiting}")
            hello_imgui.get_runner_params().app_shall_exit = True
        self._ending += 1

    def _place(self) -> tuple[float, float]:
        size = imgui.get_io().display_size
        return round(self._random.uniform(-5, size.x + 5)), round(self._random.uniform(-5, size.y + 5))

    def _later(self, *calls: Callable[[], None]) -> None:
        """One a frame."""
        self._queue.extend(calls)

    def _button(self, button: int, down: bool) -> Callable[[], None]:
        return lambda: imgui.get_io().add_mouse_button_event(button, down)

    def _to(self, place: tuple[float, float]) -> Callable[[], None]:
        return lambda: imgui.get_io().add_mouse_pos_event(*place)

    def _modified(self, share: float = 0.15) -> list[imgui.Key]:
        keys = [key for key in MODIFIERS if self._random.random() < share]
        for key in keys:
            imgui.get_io().add_key_event(key, True)
        return keys

    def _released(self, keys: list[imgui.Key]) -> list[Callable[[], None]]:
        return [lambda key=key: imgui.get_io().add_key_event(key, False) for key in keys]  # type: ignore[misc]

    def _mouse(self) -> None:
        place, button = self._place(), self._random.choices((0, 1, 2), (8, 2, 1))[0]
        times = self._random.choices((0, 1, 2), (2, 6, 2))[0]
        keys = self._modified(0.08)
        self._note(f"click {button} x{times} at {place} {[key.name for key in keys]}")
        presses = [call for _ in range(times) for call in (self._button(button, True), self._button(button, False))]
        self._later(self._to(place), *presses, *self._released(keys))

    def _drag(self) -> None:
        button, keys = self._random.choices((0, 1, 2), (8, 1, 1))[0], self._modified()
        places = [self._place()]
        for _ in range(self._random.randint(1, 8)):
            x, y = places[-1]
            near = self._random.random() < 0.7
            places.append(
                (x + self._random.randint(-60, 60), y + self._random.randint(-60, 60)) if near else self._place()
            )
        self._note(f"drag {button} {places} {[key.name for key in keys]}")
        moves = [self._to(place) for place in places]
        self._later(
            moves[0], self._button(button, True), *moves[1:], self._button(button, False), *self._released(keys)
        )

    def _wheel(self) -> None:
        x, y = self._random.choice(((0, 1), (0, -1), (0, 5), (0, -5), (1, 0)))
        keys = self._modified()
        self._note(f"wheel {x} {y} {[key.name for key in keys]}")
        self._later(lambda: imgui.get_io().add_mouse_wheel_event(x, y), *self._released(keys))

    def _press(self, key: imgui.Key) -> None:
        self._later(*(lambda down=down: imgui.get_io().add_key_event(key, down) for down in (True, False)))  # type: ignore[misc]

    def _key(self) -> None:
        key, keys = self._random.choice(KEYS), self._modified()
        if key == imgui.Key.q and imgui.Key.mod_ctrl in keys:
            return self._released_now(keys)
        self._note(f"key {key.name} {[key.name for key in keys]}")
        self._press(key)
        return self._later(*self._released(keys))

    def _released_now(self, keys: list[imgui.Key]) -> None:
        for call in self._released(keys):
            call()

    def _type(self) -> None:
        text = self._random.choice(TEXTS)
        self._note(f"type {text!r}")
        if self._random.random() < 0.3:  # Ctrl+click opens the text of a slider
            self._later(
                lambda: imgui.get_io().add_key_event(imgui.Key.mod_ctrl, True), self._button(0, True), self._button(0, False),
                lambda: imgui.get_io().add_key_event(imgui.Key.mod_ctrl, False),
            )  # fmt: skip
        self._later(lambda: imgui.get_io().add_input_characters_utf8(text))
        self._press(self._random.choice((imgui.Key.enter, imgui.Key.enter, imgui.Key.tab)))

    def _do(self) -> None:
        entry: Action = self._random.choice(self._actions)
        self._note(f"action {entry.id}")
        if entry.enabled(self.window.studio.journal):
            self.window._run(entry)

    def _tab(self) -> None:
        title = self._random.choice(list(PLACES))
        self._note(f"tab {title}")
        hello_imgui.get_runner_params().docking_params.focus_dockable_window(title)

    def _open(self) -> None:
        path = str(self._random.choice(self._files))
        self._note(f"open {Path(path).name}")
        self.window.opening.open(path)

    def _resize(self) -> None:
        import glfw  # after imgui_bundle, which brings its own library

        sizes = [self._random.choice(SIZES) for _ in range(self._random.choice((1, 1, 6)))]
        self._note(f"resize {sizes}")
        window = glfw_window_hello_imgui()
        self._later(*(lambda size=size: glfw.set_window_size(window, *size) for size in sizes))  # type: ignore[misc]

    def _clipboard(self) -> None:
        text = self._random.choice(
            ("", "{}", "[1", json.dumps({"body_pose": "x"}), "ä" * 1000, json.dumps({"expression": [1e9]}))
        )
        self._note(f"clipboard {text[:20]!r}")
        imgui.set_clipboard_text(text)

    def _escape(self) -> None:
        self._note("escape")
        self._press(imgui.Key.escape)

    def _vanish(self) -> None:
        """A folder that the window knows goes, and perhaps comes back."""
        name = self._random.choice(("library", "cache", "state", "work/runs"))
        gone = self._random.random() < 0.6
        self._note(f"folder {name} {'gone' if gone else 'there'}")
        if gone:
            shutil.rmtree(self._folder / name, ignore_errors=True)
        else:
            (self._folder / name).mkdir(parents=True, exist_ok=True)

    def _kill(self) -> None:
        """The engine's process dies."""
        number = getattr(self.window.studio.pictures.exact, "process", None)
        self._note("the engine is killed")
        if number:
            with suppress(ProcessLookupError):  # it is ending by itself
                os.kill(number, 9)


def _queued() -> float:
    """Seconds that this thread could have worked and got no processor: a busy machine is no fault of the window. 0 where nobody counts."""
    try:
        return int(Path("/proc/self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def write_files(folder: Path) -> None:
    """Files of every kind that the window opens, good and broken."""
    from avatarrex_studio.session.journal import Journal
    from avatarrex_studio.window.window import start

    from avatarrex.signals.driving import Signals
    from avatarrex.signals.read import write_json
    from avatarrex.signals.sequence import SignalSequence

    folder.mkdir(parents=True)
    frames = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(20))
    write_json(folder / "walk.json", SignalSequence(frames, 30.0, "walk"))
    Journal(start()).save(str(folder / "session.json"))
    text = (folder / "session.json").read_text()
    for name, content in {
        "cut.json": text[: len(text) // 2], "empty.json": "", "list.json": "[]", "words.bvh": "HIERARCHY\nROOT x\n{", "empty.npz": "",
        "none.avatar": "no avatar", "picture.png": "no picture", "none.zip": "PK", "none.wav": "RIFF", "none.fbx": "Kaydara",
        "none.csv": "a,b\n1", "odd.txt": "x",
    }.items():  # fmt: skip
        (folder / name).write_text(content)
    (folder / "folder").mkdir()


def fuzz(window: Window, seed: int, seconds: float, folder: Path, size: tuple[int, int] = (1280, 800)) -> Report:
    """Drive `window`, whose log is read, too, for `seconds` in `folder`, which has `files`."""
    from imgui_bundle import immapp

    driver = Fuzz(window, seed, seconds, folder)
    logging.getLogger().addHandler(driver)
    try:
        immapp.run(driver.params(size))
    finally:
        logging.getLogger().removeHandler(driver)
        driver.close()
    return driver.report


def _inside(options: argparse.Namespace) -> int:
    """The fuzzing itself, in a process whose end is seen from outside."""
    from functools import partial

    from avatarrex_studio.engine.avatars import Avatars
    from avatarrex_studio.engine.engine import Engine
    from avatarrex_studio.engine.exact import ExactEngine
    from avatarrex_studio.engine.live import LiveSurface, read_avatar
    from avatarrex_studio.engine.pages import give_pages
    from avatarrex_studio.engine.studio import Studio
    from avatarrex_studio.session.journal import Journal
    from avatarrex_studio.window.window import start

    faulthandler.enable()
    give_pages()
    folder = Path(options.folder)
    os.chdir(folder / "work")
    window = Window(
        Studio(ExactEngine(partial(Engine, device="cpu")), Avatars(read_avatar), Journal(start()), LiveSurface())
    )
    logging.basicConfig(level=logging.INFO, handlers=[window.console, window.toasts])
    report = fuzz(window, options.seed, options.seconds, folder, options.size)
    for failure in report.failures:
        print(failure, end="\n\n")
    for seconds, value in report.memory[:: max(len(report.memory) // 20, 1)]:
        print(f"{seconds:6.0f} s  {value:7.1f} MiB")
    print(f"seed {report.seed}: {report.actions} actions in {report.frames} frames, the longest {report.longest:.2f} s")
    print(
        f"{report.growth:+.1f} MiB from the middle to the end; {len(report.failures)} failures; answers: {report.answers}"
    )
    return 1 if report.failures or not report.answers else 0


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> int:
    """Fuzz in a process of its own and say how it ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the actions (1)")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long (60)")
    parser.add_argument("--size", type=_size, default=(1280, 800), help="of the window at first (1280x800)")
    parser.add_argument("--folder", help="where everything is written (a new one)")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        return _inside(options)
    folder = Path(options.folder or mkdtemp(prefix="fuzz-"))
    write_files(folder / "files")
    (folder / "work" / "runs").mkdir(parents=True)
    names = {
        "AVATARREX_LIBRARY": "library",
        "XDG_CACHE_HOME": "cache",
        "XDG_STATE_HOME": "state",
        "XDG_CONFIG_HOME": "config",
    }
    environment = {**os.environ, **{name: str(folder / place) for name, place in names.items()}}
    words = [sys.executable, __file__, "--inside", "--seed", str(options.seed), "--seconds", str(options.seconds)]
    words += ["--folder", str(folder), "--size", "{}x{}".format(*options.size)]
    code = subprocess.run(["xvfb-run", "-a", "-s", "-screen 0 2560x1440x24", *words], env=environment).returncode
    if code not in (0, 1):
        print(f"the window ended with code {code}, after\n{(folder / 'actions.txt').read_text()[-3000:]}")
    print(f"{folder} contains all that was done")
    return code


if __name__ == "__main__":
    sys.exit(main())
