"""The avatar that is open gets a surface of its own: distilled in the background, once; its file has changed then, and is read anew."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from avatarrex_studio.session.notice import refusals_logged

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import avatar_stamp
from avatarrex.files.assets import DATA
from avatarrex.files.stamp import Stamp


@runtime_checkable
class Reader(Protocol):
    """What `engine.avatars.Avatars` does."""

    def ready(self, name: str) -> Avatar | None:
        """The avatar where it has been read."""

    def stamp(self, name: str) -> Stamp:
        """That of the files it was read from."""


@runtime_checkable
class Distiller(Protocol):
    """What `jobs.distilling.Distilling` does."""

    def start(self, avatar: str) -> None:
        """Begin, or go on."""

    def progress(self) -> tuple[str, int, int] | None:
        """What is being made, how many steps of it are done, of how many."""

    def working(self) -> bool:
        """Whether it is at work."""


class OwnSurface:
    """Looks after the surfaces of whichever avatars are open."""

    def __init__(self, avatars: Reader, distiller: Distiller) -> None:
        self._avatars, self._distiller = avatars, distiller
        self._for = ""
        self._tried: dict[str, Stamp] = {}
        """Of what files one was begun: once they are others, as after a training, that may have one, too."""

    def tend(self, *names: str) -> None:
        """Begin a distillation where one of the avatars `names` has been read and has no surface."""
        if self._for and self._distiller.working():
            return
        self._for = ""
        name = next(filter(self._wanting, names), None)
        if name is None:
            return
        self._tried[name] = self._avatars.stamp(name)
        with refusals_logged():
            self._distiller.start(name)
            self._for = name

    def _wanting(self, name: str) -> bool:
        """Whether an avatar is to get one; not while its files are others than were read, as after a distillation."""
        avatar, stamp = self._avatars.ready(name), self._avatars.stamp(name)
        if avatar is None or avatar.surface is not None or stamp == self._tried.get(name, ()):
            return False
        return _of_the_user(name) and avatar_stamp(name) == stamp

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
