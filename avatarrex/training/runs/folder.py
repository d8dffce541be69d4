"""Run: the folder of one training, in which it can be watched, steered, killed and resumed.

    run.json, heartbeat.json, control.json         what it is, that it lives, what a viewer requests (control.py)
    events.out.tfevents.*                          numbers and pictures by step, for TensorBoard (events.py)
    samples/NAME/step_00001200.png                 the pictures once more, as files
    checkpoints/step_00001200/                     the state (checkpoint.py)

Scalar tags: `PART/loss/TERM`, `PART/schedule/gamma`, `PART/schedule/lr`, `PART/rate/steps_per_s`,
`PART/rate/samples_per_ray`, `PART/rate/silhouette_rays`, `PART/memory/mib`, `PART/heldout/psnr` (`ssim`, `iou`, `lpips`:
of validation). Pictures of one view are named `VIEW/render` and `VIEW/truth`: a viewer shows them side by side. Steps count from 0 in each
part.
"""

from __future__ import annotations

import io
import logging
import os
import platform
import re
import shutil
import socket
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import save_avatar
from avatarrex.errors import InputError
from avatarrex.files.gate import remove_unfinished, written
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.control import (
    STATES,
    Heart,
    Heartbeat,
    Wish,
    cannot_write,
    read_json,
    wanted,
    write_json,
)
from avatarrex.training.runs.events import EventWriter

log = logging.getLogger(__name__)
FORMAT = 1
"""Version of run.json; a reader refuses a newer one by name."""
NAME = re.compile(r"\w[\w.\-]*(/\w[\w.\-]*)*")
VERSIONS = ("avatarrex-studio", "torch", "numpy", "safetensors", "tensorboard")


class Run:
    """A run at work. One process has it open at a time; use as a context manager, or `close` it."""

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        """`Run.create` and `Run.open` are the ways in."""
        self.path, self.about = path, about
        self.step = 0
        """The last step that was reported."""
        self.part, self.pass_name, self.steps = str(about.get("part") or ""), "", 0
        self._wish: Wish = "run"
        self._control_time = 0
        (path / "control.json").unlink(missing_ok=True)  # a request to the process before
        checkpoint.clean(path / "checkpoints")
        remove_unfinished(path, below=False)
        remove_unfinished(path / "samples")
        self._events: EventWriter | None = EventWriter(path)
        self._say("running")
        self._heart = Heart(path, self._beat)
        self._heart.beat()
        self._heart.start()

    @classmethod
    def create(cls, path: str | Path, config: Mapping[str, Any]) -> Run:
        """A new run in a folder that holds none. `config`: plain JSON values; `part`, `preset`, `capture` and `seed` in
        it are shown by viewers, and `steps` (a number, or one by part) for the time that is left. Raises `InputError`.
        """
        path = Path(path)
        check_free(path, resume=False)
        shown = {name: config.get(name) for name in ("part", "preset", "capture", "seed")}
        capture = None if shown["capture"] is None else str(shown["capture"])
        about: dict[str, Any] = {
            "format": FORMAT, **shown, "capture": capture, "config": dict(config), "versions": _versions(),
            "host": socket.gethostname(), "started": time.time(), "resumed": [], "state": "running", "note": "",
        }  # fmt: skip
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(path, error) from None
        return cls(path, about)

    @classmethod
    def open(cls, path: str | Path) -> Run:
        """Go on with the run in a folder; no other process may have it open. Raises `InputError`."""
        path = Path(path)
        check_free(path, resume=True)
        about = read_about(path)
        about["resumed"] = [*about.get("resumed", []), time.time()]
        return cls(path, about)

    @property
    def config(self) -> dict[str, Any]:
        """As it was given to `create`."""
        config: dict[str, Any] = self.about["config"]
        return config

    def stage(self, part: str, pass_name: str, steps: int) -> None:
        """Say what is being trained now and at which step it ends, for whoever watches. Optional."""
        if part != self.part:
            self.step = 0
        self.part, self.pass_name, self.steps = part, pass_name, steps
        self._heart.beat()

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Report numbers by tag at one step; NaN and infinity are recorded as they are. Raises `InputError`."""
        self.step = step
        self._writer.scalars(step, {tag: float(value) for tag, value in values.items()})

    def picture(self, step: int, name: str, pixels: UInt8[np.ndarray, "h w 3"]) -> Path:
        """Keep a picture (sRGB bytes) as an event and as `samples/NAME/step_%08d.png`, its path. Raises `InputError`."""
        if not NAME.fullmatch(name):
            raise InputError(self.path, "picture", "a name such as body/walk_12/render", name)
        content = io.BytesIO()
        Image.fromarray(pixels).save(content, format="PNG", compress_level=4)
        path = self.path / "samples" / name / f"step_{step:08d}.png"
        with written(path) as temporary:
            temporary.write_bytes(content.getvalue())
        self._writer.picture(step, f"samples/{name}", content.getvalue(), (pixels.shape[1], pixels.shape[0]))
        return path

    def save(self, step: int, state: dict[str, Any], avatar: Avatar | None = None, score: float | None = None) -> Path:
        """Write checkpoint `checkpoints/step_%08d` and keep the last three and the one with the highest `score` of this
        part. `state`: nested dicts, lists and tuples of tensors, arrays and plain values. `avatar` is kept beside it.

        Raises `InputError` where the disk does not take it: the checkpoints before it are then as they were.
        """
        folder = self.path / "checkpoints"
        self.step = step
        write_avatar = None if avatar is None else lambda path: save_avatar(avatar, path)
        try:
            self._writer.sync()
            return checkpoint.write(folder, step, state, write_avatar, self.part, score)
        except (OSError, InputError) as error:
            free = shutil.disk_usage(self.path).free / 2**20
            reason = error.found if isinstance(error, InputError) else error.strerror or error
            found = f"{reason} ({free:.0f} MiB free; the checkpoints before are whole)"
            raise InputError(folder, f"step_{step:08d}", "room to write a checkpoint", found) from None

    def latest(self) -> tuple[int, dict[str, Any]] | None:
        """Step and state of the last checkpoint that is whole, tensors on the CPU; damaged ones are named in the log."""
        found = checkpoint.newest(self.path / "checkpoints")
        return None if found is None else (found[0].manifest.step, found[1])

    def control(self) -> Wish:
        """What a viewer requests: `run`, `pause` or `stop`. Cheap: a look at one file's time; call it every step."""
        try:
            changed = (self.path / "control.json").stat().st_mtime_ns
        except OSError:
            changed = 0
        if changed != self._control_time:
            self._control_time, wish = changed, wanted(self.path)
            if (wish == "pause") != (self._wish == "pause"):
                self._say("paused" if wish == "pause" else "running")
            self._wish = wish
        return self._wish

    def close(self, state: str | None = None, note: str = "") -> None:
        """End the run as `finished`, `stopped` or `failed` (with the cause in `note`); unless given, as `stopped`
        where that was requested, else as `finished`."""
        if self._events is None:
            return
        self._heart.beat()
        self._heart.stop()
        self._events.close()
        self._events = None
        try:
            self._say(state or ("stopped" if self._wish == "stop" else "finished"), note)
        except InputError:
            (self.path / "heartbeat.json").unlink(missing_ok=True)  # a full disk: dead, not alive
            raise

    def __enter__(self) -> Run:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close; a run that an exception ends has failed, and says why. Ctrl+C stops it."""
        if error is None:
            self.close()
            return
        stopped = isinstance(error, KeyboardInterrupt)
        try:
            self.close(
                "stopped" if stopped else "failed",
                "" if stopped else (str(error) or type(error).__name__).splitlines()[0],
            )
        except InputError as second:  # the first error is the one to tell
            log.warning("%s", second)

    @property
    def _writer(self) -> EventWriter:
        if self._events is None:
            raise ValueError(f"{self.path}: the run is closed")
        return self._events

    def _say(self, state: str, note: str = "") -> None:
        if state not in STATES:
            raise ValueError(f"a run is {', '.join(STATES)}, not {state}")
        self.about = {**self.about, "state": state, "note": note}
        write_json(self.path / "run.json", self.about, lasting=True)

    def _beat(self) -> Heartbeat:
        pid, host = os.getpid(), socket.gethostname()
        return Heartbeat(time.time(), pid, host, self.part, self.pass_name, self.step, self.steps)


def check_free(path: Path, resume: bool) -> None:
    """Raise `InputError` where another process works in the folder, or where it holds a run; with `resume`, where it holds none."""
    if not resume and not (path / "run.json").exists():
        return
    about, beat = read_about(path), Heartbeat.read(path)
    if about["state"] in ("running", "paused") and beat and beat.alive():
        raise InputError(path, "", "a run that no other process works on", f"process {beat.pid} on {beat.host}")
    if not resume:
        raise InputError(path, "", "a folder without a run (--resume goes on with one)", "run.json")


def read_about(path: Path) -> dict[str, Any]:
    """run.json of a run folder, checked. Raises `InputError`."""
    about = read_json(path / "run.json")
    if about is None:
        raise InputError(path, "", "a run folder with run.json", "none that can be read")
    if type(about.get("format")) is not int or about["format"] > FORMAT:
        raise InputError(path, "run.json: format", f"at most {FORMAT} (update the studio)", about.get("format"))
    if about.get("state") not in STATES or not isinstance(about.get("config"), dict):
        raise InputError(path, "run.json", "a state and a config", about.get("state"))
    if not isinstance(about.get("resumed", []), list):
        raise InputError(path, "run.json: resumed", "a list of times", about["resumed"])
    return about


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
