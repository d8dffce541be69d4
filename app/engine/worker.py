"""The process of the exact engine: it takes a request from the pipe, renders, answers, and sleeps until the next.

A thread reads the pipe, so that a picture can be cancelled between two stages and the process ends when the pipe breaks.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.field_slice import over
from avatarrex_studio.engine.influences import of_points
from avatarrex_studio.engine.looks import OwnColours, shown
from avatarrex_studio.engine.pages import keep_pages
from avatarrex_studio.engine.passes import nearest
from avatarrex_studio.engine.request import Answer, Picture, Request
from avatarrex_studio.engine.slices import send
from avatarrex_studio.engine.staging import in_light, over_stage, together
from avatarrex_studio.engine.work import Work
from avatarrex_studio.session.state import IMAGE, INFLUENCE, SLICE, StudioState
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.errors import InputError
from avatarrex.files.images import write_png
from avatarrex.frame import DeferredFrame, Frame

log = logging.getLogger(__name__)
READY, CANCEL = "ready", "cancel"
"""Messages beside requests and answers: the engine is made; stop the picture under way."""
NICENESS = 5
"""The interface comes first."""


@runtime_checkable
class Make(Protocol):
    """Makes the engine, in its process."""

    def __call__(self, *, between: Callable[[], None]) -> Engine:
        """`between` is to be called between stages and may raise `Cancelled`."""


class Cancelled(BaseException):
    """The picture is not wanted any more; no error, so that nothing on the way takes it for one."""


class Inbox:
    """What the pipe brings."""

    def __init__(self, connection: Connection) -> None:
        self.requests: SimpleQueue[Request] = SimpleQueue()
        self._cancelled = threading.Event()
        threading.Thread(target=self._read, args=(connection,), daemon=True).start()

    def check(self) -> None:
        """Raise `Cancelled` where the request under way is not wanted any more."""
        if self._cancelled.is_set():
            raise Cancelled

    def _read(self, connection: Connection) -> None:
        """One request is under way at a time: a new one means that the last was answered."""
        try:
            while True:
                message = connection.recv()
                if message == CANCEL:
                    self._cancelled.set()
                else:
                    self._cancelled.clear()
                    self.requests.put(message)
        except (EOFError, OSError):
            os._exit(0)  # whoever sent it is gone; a picture under way is of no use


def serve(connection: Connection, make: Make) -> None:
    """The process's main function."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is for the window, and the pipe tells
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    keep_pages()
    inbox = Inbox(connection)
    engine = make(between=inbox.check)
    _reply(connection, READY)
    while True:
        request = inbox.requests.get()
        try:
            answer = answered(engine, request)
        except Cancelled:
            answer = Answer(request, cancelled=True)
        _reply(connection, answer)


def _reply(connection: Connection, message: object) -> None:
    """Send it; a window that was closed meanwhile ends the process, without a trace."""
    try:
        send(connection, message)
    except BrokenPipeError:
        os._exit(0)


def answered(engine: Engine, request: Request) -> Answer:
    """Render and, where the request names a file, write it."""
    shot = engine.render(request.state, request.size, request.dragged)
    if shot.error or not shot.frames:
        return Answer(request, error=shot.error)
    try:
        return _of_frames(engine, request, shot.frames)
    except InputError as error:
        return Answer(request, error=str(error))
    except Exception as error:  # a fault of ours: its trace goes to the log, its line to the window
        log.exception("the picture could not be lit or written")
        return Answer(request, error=f"{type(error).__name__}: {error}".splitlines()[0])


def _of_frames(engine: Engine, request: Request, frames: tuple[Frame, ...]) -> Answer:
    """What a picture is wanted for. Raises `InputError` where it cannot be written."""
    state = request.state
    if request.path:
        pixels = over_stage(in_light(frames, state), state)
        write_png(request.path, pixels, {"avatarrex": json.dumps(state.to_json())})
        return Answer(request)
    deferred = [frame for frame in frames if isinstance(frame, DeferredFrame)]
    assert len(deferred) == len(frames), "the surface is drawn by whoever shows it"
    floor, shows = None, state.tools.shows
    if shows == IMAGE:
        seen = in_light(frames, state)
        image, floor = seen.image, seen.floor
    else:
        image = _seen(engine, state, deferred)
    pixels = np.rint(255 * image.float().cpu().numpy().clip(0, 1)).astype(np.uint8)
    depth, figure = nearest(frames)
    return Answer(request, Picture(pixels, depth, figure, Work.of(deferred, state.level), floor))


def _seen(engine: Engine, state: StudioState, frames: Sequence[DeferredFrame]) -> Tensor:
    """(h, w, 4): what else than its image is shown of the frames, premultiplied."""
    shows, images = state.tools.shows, []
    for frame, figure in zip(frames, state.each()):
        own = _influences(engine.avatar(figure.avatar), frame, state) if shows == INFLUENCE else None
        images.append(torch.from_numpy(shown(frame, shows, state.view, own)))
    image = together(frames, images)
    return torch.from_numpy(over(frames, image.numpy(), state.tools.cut)) if shows == SLICE else image


def _influences(avatar: Avatar, frame: Frame, state: StudioState) -> OwnColours:
    """The colours of points of a frame by what carries them."""
    world = frame.world_from_root
    return lambda point: of_points(avatar, frame.signals, point @ world[:3, :3].T + world[:3, 3], state.tools.selected)
