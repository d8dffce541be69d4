"""The window as somebody in front of it sees it: input to picture, frames a second, idling, how a picture settles.

    python tools/measure_window.py [--motion FILE [--face FILE]] [--seconds S] [--repeats N] [--only NAME …] [--strip OUT.png]

Starts the window on an Xvfb of its own at 1280×800, moves the mouse by XTest (xdotool) and looks at the pixels in the server's
memory (`Xvfb -fbdir`), so that the window itself does nothing for it. A latency is the time from the line that xdotool is given
to the first changed pixel of a band that the person moves through; a rate counts its pictures. Processor time is
that of the window's process and of its engine's. Run it on a quiet machine. Debian: xvfb, xdotool.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.live import read_avatar
from avatarrex_studio.jobs.training_process import COMMAND
from avatarrex_studio.live import livelink_packet
from avatarrex_studio.live.receiver import LOOPBACK
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.motion import Motion
from avatarrex_studio.session.timeline import Feed, Layer
from avatarrex_studio.session.timeline_commands import AddLayer
from avatarrex_studio.window.window import prepared, run, start
from PIL import Image

from avatarrex.metrics.table import printed
from avatarrex.signals.joints import JOINT_ROWS
from avatarrex.signals.read import read_motion

SIZE = (1280, 800)
VIEWPORT = (slice(40, 560), slice(240, 820))
"""Rows and columns of the picture, in the layout that a first start has; the pointer, which the server draws, stays out of it."""
BAND, HAND, HEAD = (
    (slice(236, 260), slice(240, 820, 2)),
    (slice(260, 340), slice(600, 672)),
    (slice(80, 150), slice(500, 556)),
)
"""Across chest and arms, of the left hand, of the face."""
PANEL = (slice(300, 324), slice(850, 1250, 2))
"""Across the sliders of the Body panel."""
ORBIT, SCROLL, PLAY = (350, 520), (1274, 120), (309, 611)
"""Where the mouse is pressed: beside the person, on the Body panel's scroll bar, on Play."""


PORT = 47311
"""Where the window listens for a face while that is measured."""


class Drag(NamedTuple):
    """A drag of the mouse, and where it changes the picture."""

    name: str
    tab: tuple[int, int]
    """The panel's, at the right."""
    place: tuple[int, int]
    step: tuple[int, int]
    """Pixels of a move."""
    seen: tuple[slice, slice]


BODY_TAB, HAND_TAB, FACE_TAB = (862, 35), (926, 35), (1072, 35)
DRAGS = (
    Drag("orbit", BODY_TAB, ORBIT, (6, 0), BAND),
    Drag("pose slider", BODY_TAB, (1203, 444), (2, 0), BAND),
    Drag("hand slider", HAND_TAB, (1090, 125), (2, 0), HAND),
    Drag("expression slider", FACE_TAB, (1090, 154), (2, 0), HEAD),
)
"""Everything round; a shoulder's third angle; all fingers of the left hand; the first expression."""
RATE = 125.0
"""Moves of the mouse a second: a common mouse's."""
STILL, PATIENCE = 0.7, 120.0
"""Seconds without a changed pixel that count as rest, and that rest is waited for."""
NUDGES, PIECES, PIECE, BUSY = 6, 8, 0.25, 0.5
"""Poses rendered beside a scrolled panel; pieces that are looked at of each, and their seconds; processor time, in cores, with which
the engine counts as rendering in one."""
TICKS = os.sysconf("SC_CLK_TCK")


class Display:
    """An X server, its pixels, and a mouse."""

    def __init__(self, folder: Path) -> None:
        read, write = os.pipe()
        words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "{}x{}x24".format(*SIZE), "-fbdir", str(folder)]
        self._server = subprocess.Popen([*words, "-nolisten", "tcp"], pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as answer:
            self.environment = {**os.environ, "DISPLAY": f":{answer.readline().strip()}"}
        self._mouse = subprocess.Popen(["xdotool", "-"], stdin=subprocess.PIPE, text=True, env=self.environment)
        file = folder / "Xvfb_screen0"
        head = np.fromfile(file, ">u4", 25)  # XWDFile.h: header size, …, [12] bytes a line, …, [19] colours of 12 bytes
        raster = np.memmap(file, np.uint8, "r", int(head[0] + 12 * head[19]), (SIZE[1], int(head[12])))
        self.pixels = raster.reshape(SIZE[1], -1, 4)[:, : SIZE[0]]
        """(h, w, 4) blue, green, red, nothing."""

    def mouse(self, *commands: str) -> None:
        """Commands of xdotool, e.g. `mousemove 3 4`."""
        assert self._mouse.stdin is not None
        self._mouse.stdin.write("\n".join(commands) + "\n")
        self._mouse.stdin.flush()

    def click(self, place: tuple[int, int]) -> None:
        """Press and let go, long enough for a frame to see it."""
        self.mouse("mousemove {} {}".format(*place), "mousedown 1")
        time.sleep(0.2)
        self.mouse("mouseup 1")
        time.sleep(0.2)

    def look(self, place: tuple[slice, slice]) -> bytes:
        """The pixels at a place."""
        return self.pixels[place].tobytes()

    def rest(self, place: tuple[slice, slice], still: float = STILL) -> None:
        """Wait until nothing changes there."""
        until, last, since = time.monotonic() + PATIENCE, b"", time.monotonic()
        while time.monotonic() - since < still:
            if time.monotonic() > until:
                raise SystemExit("the picture goes on changing")
            time.sleep(0.02)
            now = self.look(place)
            if now != last:
                last, since = now, time.monotonic()

    def close(self) -> None:
        """End both."""
        for process in (self._mouse, self._server):
            process.terminate()
            process.wait()


@contextmanager
def window(level: str, motion: str | None, face: str | None = None, port: int = 0) -> Iterator[tuple[Display, int]]:
    """The studio at `level` on a display of its own, at rest; with the number of its process. `port`: where it listens for a face."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        state = start().change(level=level)
        if motion:
            played = with_face(motion, face, folder) if face else motion
            state = Motion.read(played).loaded().apply(state)
        Journal(state).save(folder / "session.json")
        display = Display(folder)
        environment = {**display.environment, "HOME": name, "XDG_CONFIG_HOME": name}
        listening = [sys.executable, __file__, "--listen", str(port)]
        opened = [*(listening if port else [*COMMAND, "open"]), str(folder / "session.json")]
        shown = subprocess.Popen(opened, env=environment)
        try:
            before = display.look(VIEWPORT)
            while display.look(VIEWPORT) == before:
                time.sleep(0.1)
            display.rest(VIEWPORT, 3.0)
            yield display, shown.pid
        finally:
            shown.terminate()
            shown.wait()
            display.close()


def with_face(motion: str, face: str, folder: Path) -> str:
    """A file of the body's frames with those of the face, from the first on, over and over."""
    body, expressions = read_motion(motion), [frame.expression for frame in read_motion(face)]
    pose = np.stack([frame.full_pose() for frame in body])
    parts = ("global_orient", "body_pose", "left_hand_pose", "right_hand_pose")
    np.savez(
        folder / "both.npz",
        fps=body.fps,
        transl=np.stack([frame.translation for frame in body]),
        arkit52=np.stack([expressions[k % len(expressions)] for k in range(len(body))]),
        **{part: pose[:, JOINT_ROWS[part]].reshape(len(pose), -1) for part in parts},
    )
    return str(folder / "both.npz")


def latency(display: Display, drag: Drag, repeats: int) -> list[float]:
    """Milliseconds from a move of the pressed mouse to a changed picture; the window has been at rest each time."""
    display.click(drag.tab)
    x, y = drag.place
    display.mouse(f"mousemove {x} {y}", "mousedown 1")
    found = []
    for k in range(repeats):
        display.rest(VIEWPORT, random.uniform(0.3, 0.8))
        before, begun = display.look(drag.seen), time.perf_counter()
        display.mouse(f"mousemove {x + 12 * (1 - k % 2)} {y}")
        while display.look(drag.seen) == before:
            time.sleep(5e-4)
            if time.perf_counter() - begun > PATIENCE:
                raise SystemExit(f"the mouse at {drag.place} moves nothing: another layout?")
        found.append(1e3 * (time.perf_counter() - begun))
    display.mouse("mouseup 1")
    return found


@contextmanager
def dragged(display: Display, place: tuple[int, int], step: tuple[int, int]) -> Iterator[None]:
    """The mouse pressed and moved to and fro, `step` pixels a move, meanwhile; in the end it is where it began."""
    over = threading.Event()

    def move() -> None:
        k, due = 0, time.perf_counter()
        while not over.is_set():
            away = 20 - abs(k % 40 - 20)
            display.mouse(f"mousemove {place[0] + step[0] * away} {place[1] + step[1] * away}")
            k, due = k + 1, due + 1 / RATE
            time.sleep(max(0.0, due - time.perf_counter()))

    display.mouse(f"mousemove {place[0]} {place[1]}", "mousedown 1")
    thread = threading.Thread(target=move)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        display.mouse("mousemove {} {}".format(*place))
        time.sleep(0.2)  # a frame sees it
        display.mouse("mouseup 1")


@contextmanager
def streamed(port: int) -> Iterator[None]:
    """A phone that sends a face that speaks and turns."""
    over = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
            while not over.wait(1 / 60):
                way = math.sin(4 * time.monotonic())
                face = livelink_packet.encode({"jawOpen": 0.3 + 0.3 * way}, (0.3 * way, 0.0, 0.0))
                phone.sendto(face, (LOOPBACK, port))

    phone = threading.Thread(target=send)
    phone.start()
    try:
        time.sleep(1.0)
        yield
    finally:
        over.set()
        phone.join()


def listen(session: str, port: int) -> int:
    """The window of a session with a layer that listens for a face."""
    shown = prepared(session, Avatars(read_avatar), "cpu")
    shown.studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"))))
    shown.studio.listening.switch_on("Phone", "livelink", port=port)
    return run(shown)


def pictures(display: Display, place: tuple[slice, slice], seconds: float) -> list[float]:
    """Seconds at which the pixels at a place had changed."""
    times, last, until = [], display.look(place), time.perf_counter() + seconds
    while (now := time.perf_counter()) < until:
        seen = display.look(place)
        if seen != last:
            times.append(now)
            last = seen
        time.sleep(0.002)
    return times


def rates(times: list[float]) -> tuple[float, float]:
    """Pictures a second by the median distance, and by the distance that 95 of 100 keep."""
    apart = np.diff(times)
    return 1 / float(np.median(apart)), 1 / float(np.quantile(apart, 0.95))


def processor(pid: int) -> tuple[float, float]:
    """Processor seconds of a process, and of its children."""

    def of(number: int) -> float:
        fields = Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    threads = Path(f"/proc/{pid}/task").iterdir()
    children = [int(child) for thread in threads for child in (thread / "children").read_text().split()]
    spent = 0.0
    for child in children:
        with suppress(OSError):
            spent += of(child)
    return of(pid), spent


class Measuring:
    """What `--only` names, each on a window of its own."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self._row = printed("at the screen".ljust(34), "median", "95 of 100", "")

    def start(self) -> None:
        """From the command to the first window, to the studio's own, and to the avatar in it."""
        for _ in range(self.options.starts):
            with TemporaryDirectory() as name:
                display = Display(Path(name))
                environment = {
                    **display.environment,
                    "XDG_CONFIG_HOME": name,
                    "XDG_STATE_HOME": name,
                }  # caches are warm after the first
                begun = time.perf_counter()
                shown = subprocess.Popen([*COMMAND, "open"], env=environment)
                try:
                    seconds = [_until(begun, seen, display) for seen in (_any, _panels, _person)]
                finally:
                    shown.terminate()
                    shown.wait()
                    display.close()
            self._row(
                "start, a window",
                f"{seconds[0]:.1f} s",
                "",
                f"the studio's {seconds[1]:.1f} s, the avatar {seconds[2]:.1f} s",
            )

    def latency(self) -> None:
        """Input to picture, from rest."""
        with window("live", None) as (display, _):
            for drag in DRAGS:
                found = latency(display, drag, self.options.repeats)
                self._row(
                    f"latency, {drag.name}", *(f"{x:.0f} ms" for x in (median(found), np.quantile(found, 0.95))), ""
                )

    def rate(self) -> None:
        """Pictures a second while the surface moves."""
        with window("live", None) as (display, pid):
            for drag in DRAGS:
                display.click(drag.tab)
                with dragged(display, drag.place, drag.step):
                    self._rate(display, drag.name, drag.seen, pid)
                display.rest(VIEWPORT)
        if self.options.motion:
            with window("live", self.options.motion, self.options.face) as (display, pid):
                display.mouse("mousemove {} {}".format(*PLAY), "click 1")
                self._rate(display, f"motion {Path(self.options.motion).name}", BAND, pid)

    def stream(self) -> None:
        """Pictures a second while a face comes in, 60 times a second."""
        with window("live", None, port=PORT) as (display, pid), streamed(PORT):
            self._rate(display, "Live Link Face", HEAD, pid)

    def interface(self) -> None:
        """A panel that is scrolled, at rest and beside an engine that renders."""
        with window("quality", None) as (display, pid):
            with dragged(display, SCROLL, (0, 6)):
                self._rate(display, "interface, nothing rendered", PANEL, pid)
            apart: list[float] = []
            seconds = 0.0
            for k in range(NUDGES):
                self._nudged(display, k)
                with dragged(display, SCROLL, (0, 6)):
                    for _ in range(PIECES):
                        before, begun = processor(pid)[1], time.perf_counter()
                        times = pictures(display, PANEL, PIECE)
                        took = time.perf_counter() - begun
                        if processor(pid)[1] - before > BUSY * took:
                            apart, seconds = [*apart, *np.diff(times)], seconds + took
                display.rest(VIEWPORT, 3.0)
            if len(apart) < 2:
                raise SystemExit("the engine rendered nothing beside the panel")
            values = (1 / float(np.median(apart)), 1 / float(np.quantile(apart, 0.95)))
            words = f"in {seconds:.1f} s in which it took more than {BUSY} cores"
            self._row("interface, `quality` rendered", *(f"{value:.0f} fps" for value in values), words)

    def idle(self) -> None:
        """Processor time of a window that nobody touches."""
        with window("balanced", None) as (display, pid):
            display.rest(VIEWPORT, 5.0)
            before = processor(pid)
            seen = len(pictures(display, (slice(None), slice(None)), 10.0))
            own, engine = (1e2 * (now - then) / 10 for now, then in zip(processor(pid), before))
            self._row("idle for 10 s", f"{own:.1f} %", f"{engine:.1f} %", f"of a core: window, engine; {seen} changes")

    def settling(self) -> None:
        """A motion that stops: the last pictures of the surface, the exact one faded in, and what changed."""
        if not (self.options.motion and self.options.strip):
            return
        with window("balanced", self.options.motion, self.options.face) as (display, _):
            display.mouse("mousemove {} {}".format(*PLAY), "click 1")
            time.sleep(1.5)
            display.mouse("click 1")
            seen = _distinct(display, 6.0)
        rest = 1 + int(np.argmax(np.diff([at for at, _ in seen])))
        moving, fading = seen[:rest], [seen[k] for k in np.linspace(rest, len(seen) - 1, 5).astype(int)]
        Image.fromarray(_strip([picture for _, picture in (*moving[-3:], *fading)])).save(self.options.strip)
        steps = [_apart(one, other) for (_, one), (_, other) in pairwise(seen[rest - 1 :])]
        whole = _apart(moving[-1][1], fading[-1][1])
        words = f"of 255: mean over the person, {len(steps)} steps in {fading[-1][0] - fading[0][0]:.2f} s"
        self._row("settling, surface to exact", f"{whole[0]:.1f}", f"{whole[1]:.0f}", words)
        largest = max(steps)
        self._row(
            "settling, the largest step",
            f"{largest[0]:.1f}",
            f"{largest[1]:.0f}",
            f"first one {fading[0][0] - moving[-1][0]:.1f} s after the last of the surface",
        )

    def _nudged(self, display: Display, number: int) -> None:
        """A shoulder turned a little, and the engine begun."""
        x, y = DRAGS[1].place
        for command in (
            f"mousemove {x} {y}",
            "mousedown 1",
            f"mousemove {x + 20 - 40 * (number % 2)} {y}",
            "mouseup 1",
        ):
            display.mouse(command)
            time.sleep(0.1)

    def _rate(self, display: Display, name: str, place: tuple[slice, slice], pid: int) -> None:
        before = processor(pid)[0]
        times = pictures(display, place, self.options.seconds)
        if len(times) < 3:
            raise SystemExit(f"{name}: nothing moves: another layout?")
        used = (processor(pid)[0] - before) / self.options.seconds
        self._row(name, *(f"{value:.0f} fps" for value in rates(times)), f"{used:.2f} cores")


def _any(pixels: np.ndarray) -> bool:
    """Whether anything is on the screen."""
    return bool(pixels[..., :3].any())


def _panels(pixels: np.ndarray) -> bool:
    """Whether the studio's panels are."""
    return bool(pixels[PANEL][..., :3].any())


def _person(pixels: np.ndarray) -> bool:
    """Whether the avatar is: something bright across its chest, while the panels are there."""
    return _panels(pixels) and bool((pixels[BAND][..., :3].min(-1) > 150).sum() > 50)


def _until(begun: float, seen: Callable[[np.ndarray], bool], display: Display) -> float:
    """Seconds since `begun` when something is first seen."""
    while not seen(display.pixels):
        time.sleep(0.01)
        if time.perf_counter() - begun > PATIENCE:
            raise SystemExit("nothing is seen")
    return time.perf_counter() - begun


def _distinct(display: Display, seconds: float) -> list[tuple[float, np.ndarray]]:
    """Every picture of the viewport that differs from the one before, and when."""
    found: list[tuple[float, np.ndarray]] = []
    begun = time.perf_counter()
    while (at := time.perf_counter() - begun) < seconds:
        picture = display.pixels[VIEWPORT][..., 2::-1].copy()
        if not found or not np.array_equal(picture, found[-1][1]):
            found.append((at, picture))
        time.sleep(0.005)
    return found


def _apart(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Difference of two pictures in bytes where there is more than the background: its mean, and what 95 of 100 keep."""
    person = (np.abs(one.astype(int) - one[0, 0]) + np.abs(other.astype(int) - other[0, 0])).sum(-1) > 0
    apart = np.abs(one.astype(int) - other).mean(-1)[person]
    return float(apart.mean()), float(np.quantile(apart, 0.95))


def _strip(chosen: list[np.ndarray]) -> np.ndarray:
    """Pictures above what each changed, four times as strong."""
    changes = [np.zeros_like(chosen[0])]
    changes += [np.clip(4 * np.abs(b.astype(int) - a), 0, 255).astype(np.uint8) for a, b in pairwise(chosen)]
    return np.vstack([np.hstack(chosen), np.hstack(changes)])


def main() -> None:
    """Measure and print."""
    names = ("start", "latency", "rate", "stream", "interface", "idle", "settling")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motion", help="a motion file that is played, too")
    parser.add_argument("--face", help="a recording of a face that is played with it")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each rate (4)")
    parser.add_argument("--repeats", type=int, default=30, help="of each latency (30)")
    parser.add_argument("--starts", type=int, default=3, help="of the program (3)")
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="some of the measurements")
    parser.add_argument("--strip", help="a PNG of the pictures in which a motion stops")
    parser.add_argument("--listen", type=int, help=argparse.SUPPRESS)
    parser.add_argument("session", nargs="?", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        sys.exit(listen(options.session, options.listen))
    measuring = Measuring(options)
    for name in measuring.options.only:
        measure: Callable[[], None] = getattr(measuring, name)
        measure()


if __name__ == "__main__":
    main()
