"""The journal of a session: where it started, each undo step's commands, and the way back.

A step is one gesture: a whole drag, a whole playback. `replay` of the saved file gives the state that the window had.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from avatarrex_studio.session import timeline_commands  # noqa: F401  what a file of before or of now names
from avatarrex_studio.session.commands import Choice, Command, Setting
from avatarrex_studio.session.state import StudioState

from avatarrex.errors import InputError
from avatarrex.files.gate import write_text
from avatarrex.files.json_text import read_json

FORMAT = 1
SESSION_BYTES = 2**26
"""Bytes of a file: ten thousand frames of a motion that was played."""
COMMANDS = 100_000
"""Of a file, in all its steps: an hour of one gesture at 30 a second; as many are applied in seconds."""
STEPS = 200
"""Undo steps that are kept; older ones become part of the start."""


@dataclass
class Step:
    """The commands of one gesture and the state before them."""

    before: StudioState
    commands: list[Command]
    gesture: object = None
    previous: StudioState | None = None
    """The state before the last command, where another may take its place."""


@dataclass(frozen=True)
class Snapshot:
    """A journal at one moment, for a thread that writes it."""

    start: StudioState
    steps: tuple[tuple[Command, ...], ...]

    def to_json(self) -> dict[str, Any]:
        """The session file's content."""
        return {
            "format": FORMAT,
            "kind": "session",
            "start": self.start.to_json(),
            "steps": [[command.to_json() for command in step] for step in self.steps],
        }


@dataclass
class Journal:
    """A state with its history."""

    start: StudioState = field(default_factory=StudioState)
    steps: list[Step] = field(default_factory=list)
    undone: list[Step] = field(default_factory=list)
    state: StudioState = field(init=False)
    path: str | None = field(default=None, compare=False)
    """The file that it was last saved to, or read from."""
    saved: StudioState | None = field(init=False, compare=False)
    """The state that needs no saving: the file's, or that of a new session; None: there is none."""

    def __post_init__(self) -> None:
        self.state = _after(self.start, [command for step in self.steps for command in step.commands])
        self.saved = self.state

    @property
    def unsaved(self) -> bool:
        """Whether there is work to lose. A look from elsewhere, another level or a tool is none."""
        return self.saved is None or (self.state is not self.saved and _work(self.state) != _work(self.saved))

    def do(self, command: Command, gesture: object = None) -> StudioState:
        """Apply `command`; commands that share a `gesture` (not None) are undone together. Raises `InputError`."""
        last = self.steps[-1] if self.steps else None
        shared = last if last and gesture is not None and last.gesture == gesture else None
        if shared and supersedes(command, shared.commands[-1]):
            return self._replaced(shared, command)
        state = command.apply(self.state)
        if state == self.state:
            return state
        if isinstance(command, Choice):
            self.state = state
            return state
        if shared:
            shared.commands.append(command)
            shared.previous = self.state
        else:
            self._add(Step(self.state, [command], gesture, self.state))
        self.undone.clear()
        self.state = state
        return state

    def before(self, command: Command, gesture: object = None) -> StudioState:
        """The state that `do` would apply a command to: without the last command where this one takes its place."""
        last = self.steps[-1] if self.steps else None
        shared = last is not None and gesture is not None and last.gesture == gesture
        return self._without_last(command) if shared else self.state

    def before_following(self, command: Command) -> StudioState:
        """The same for `follow`."""
        return self._without_last(command)

    def _without_last(self, command: Command) -> StudioState:
        last = self.steps[-1] if self.steps else None
        if last is None or last.previous is None or not supersedes(command, last.commands[-1]):
            return self.state
        return self._present(last.previous)

    def _replaced(self, step: Step, command: Command) -> StudioState:
        """With `command` in place of the last of `step`, which goes where that leads back to its beginning."""
        assert step.previous is not None
        self.state = command.apply(self._present(step.previous))  # what a replay will do, to the last bit
        step.commands[-1] = command
        if self.state == self._present(step.before):
            self.steps.pop()
        return self.state

    def follow(self, command: Command) -> StudioState:
        """Apply what nobody did: a frame that a live source sent belongs to the last step. Raises `InputError`."""
        last = self.steps[-1] if self.steps else None
        if last is None:
            self.state = self.start = command.apply(self.state)
        elif last.previous is not None and supersedes(command, last.commands[-1]):
            self.state = command.apply(self._without_last(command))
            last.commands[-1] = command
        else:
            last.previous, self.state = self.state, command.apply(self.state)
            last.commands.append(command)
        return self.state

    def undo(self) -> StudioState:
        """Back over the last step; nothing where there is none."""
        if self.steps:
            step = self.steps.pop()
            self.undone.append(step)
            self.state = self._present(step.before)
        return self.state

    def redo(self) -> StudioState:
        """Forward over the step that was undone last."""
        if self.undone:
            step = self.undone.pop()
            self.steps.append(Step(self.state, step.commands))
            self.state = _after(self.state, step.commands)
        return self.state

    def to_json(self) -> dict[str, Any]:
        """The session file's content."""
        return self.snapshot().to_json()

    def snapshot(self) -> Snapshot:
        """What `to_json` writes, apart from what will be done next."""
        return Snapshot(self._present(self.start), tuple(tuple(step.commands) for step in self.steps))

    @classmethod
    def from_json(cls, data: Any, source: str = "session") -> Journal:
        """From `to_json`'s dictionary. Raises `InputError`."""
        if not isinstance(data, dict) or data.get("kind") != "session" or not isinstance(data.get("steps"), list):
            raise InputError(source, "kind", "a session of the studio", type(data).__name__)
        if not isinstance(data.get("format"), int) or data["format"] > FORMAT:
            raise InputError(source, "format", f"at most {FORMAT} (update the studio)", data.get("format"))
        with _placed(source, "start"):
            journal = cls(StudioState.from_json(data.get("start"), f"{source}: start"))
        for number, entries in enumerate(data["steps"]):
            if not isinstance(entries, list):
                raise InputError(source, f"steps[{number}]", "a list of commands", type(entries).__name__)
        if (count := sum(map(len, data["steps"]))) > COMMANDS:
            raise InputError(source, "steps", f"at most {COMMANDS:,} commands", f"{count:,}")
        for number, entries in enumerate(data["steps"]):
            journal._read(entries, source, f"steps[{number}]")
        journal.saved = journal.state
        return journal

    def _read(self, entries: list[Any], source: str, place: str) -> None:
        """Do the commands of one step of a file."""
        step = Step(self.state, [])
        for entry in entries:
            with _placed(source, place):
                command = Command.from_json(entry, source)
                state = command.apply(self.state)
            if state != self.state:
                step.commands.append(command)
                self.state = state
        if step.commands:
            self._add(step)

    def _present(self, state: StudioState) -> StudioState:
        """`state` with the tools of now: an undo does not take the selection away."""
        return state.change(tools=self.state.tools)

    def _add(self, step: Step) -> None:
        """One more step; the first becomes part of the start where there are too many."""
        self.steps.append(step)
        if len(self.steps) > STEPS:
            del self.steps[0]
            self.start = self.steps[0].before

    def save(self, path: str | Path) -> None:
        """Write the session, all or nothing; from then on it is saved. Raises `InputError`."""
        write_text(path, json.dumps(self.to_json(), indent=1))
        self.path, self.saved = str(path), self.state

    @classmethod
    def load(cls, path: str | Path) -> Journal:
        """Read a session file. Raises `InputError`."""
        journal = cls.from_json(read_json(path, "a session file", SESSION_BYTES), str(path))
        journal.path = str(path)
        return journal


@contextmanager
def _placed(source: str, place: str) -> Iterator[None]:
    """Errors over what a file says name the file and the place in it."""
    try:
        yield
    except InputError as error:
        if error.source.startswith(source):
            raise
        raise InputError(f"{source}: {place}: {error.source}", error.field, error.expected, error.found) from None
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(source, place, "values of the right kind", error) from None


def supersedes(later: Command, earlier: Command) -> bool:
    """Whether `earlier` has no effect before `later`: a setting of the same joint, coefficient or field."""
    same = all(getattr(earlier, name, None) == getattr(later, name, None) for name in ("joint", "name", "index"))
    return isinstance(later, Setting) and type(earlier) is type(later) and same


def _work(state: StudioState) -> tuple[object, ...]:
    """The state's values without what only says how it is looked at."""
    return tuple(value for name, value in vars(state).items() if name not in ("view", "tools", "level"))


def _after(state: StudioState, commands: list[Command]) -> StudioState:
    for command in commands:
        state = command.apply(state)
    return state
