"""The avatar that is open gets a surface of its own: distilled in the background, once, and then shown."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Protocol, runtime_checkable

from avatarrex_studio.session.notice import refusals_logged

from avatarrex.avatar import Avatar
from avatarrex.files.assets import DATA

log = logging.getLogger(__name__)


@runtime_checkable
class Reader(Protocol):
    """What `engine.avatars.Avatars` does."""

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read."""

    def read_again(self, name: str) -> None:
        """Read it anew."""


@runtime_checkable
class Distiller(Protocol):
    """What `jobs.distilling.Distilling` does."""

    def start(self, avatar: str) -> None:
        """Begin, or go on."""

    def progress(self) -> tuple[str, int, int] | None:
        """What is being made, how many steps of it are done, of how many."""

    def working(self) -> bool:
        """Whether it is at work."""

    def finished(self) -> bool:
        """Whether the avatar has got its surface."""


class OwnSurface:
    """Looks after the surfaces of whichever avatars are open."""

    def __init__(self, avatars: Reader, distiller: Distiller) -> None:
        self._avatars, self._distiller = avatars, distiller
        self._for = ""
        self._tried: set[str] = set()

    def tend(self, *names: str) -> None:
        """Begin a distillation where one of the avatars `names` has been read and has no surface; show one that is done."""
        if self._for:
            if self._distiller.working():
                return
            if self._distiller.finished():
                log.info("%s has its surface now", self._for)
                self._avatars.read_again(self._for)
            self._for = ""
        name = next(filter(self._wanting, names), None)
        if name is None:
            return
        self._tried.add(name)
        with refusals_logged():
            self._distiller.start(name)
            self._for = name

    def _wanting(self, name: str) -> bool:
        """Whether an avatar is to get one."""
        avatar = self._avatars.ready(name)
        return avatar is not None and avatar.surface is None and name not in self._tried and _of_the_user(name)

    @property
    def words(self) -> str:
        """What is under way, for the status bar; empty where nothing is."""
        progress = self._distiller.progress() if self._for else None
        return "" if progress is None else "distilling: {} {}/{}".format(*progress)


def _of_the_user(name: str) -> bool:
    """Whether the avatar's file may be rewritten: neither the packaged one nor one that a training keeps."""
    path = Path(name).absolute()
    return (
        name != "default"
        and DATA not in path.parents
        and not {"checkpoints", "avatars"} & {p.name for p in path.parents}
    )
