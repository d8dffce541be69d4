"""The window gives an avatar without a surface one, in the background, once."""

from __future__ import annotations

from pathlib import Path

import pytest
from avatarrex_studio.window.own_surface import OwnSurface

from avatarrex.avatar_file import avatar_stamp
from avatarrex.errors import InputError


@pytest.fixture
def file(tmp_path):
    """Of an avatar."""
    path = tmp_path / "me.avatar"
    path.write_bytes(b"as trained")
    return str(path)


class Avatar:
    def __init__(self, surface):
        self.surface = surface


class Avatars:
    def __init__(self, name, surface=None):
        self.read(name, surface)

    def read(self, name, surface=None):
        self.avatar, self.read_at = Avatar(surface), avatar_stamp(name)

    def ready(self, name):
        return self.avatar

    def stamp(self, name):
        return self.read_at


class Distiller:
    def __init__(self, refuses=False):
        self.started, self.state, self.refuses = [], "", refuses

    def start(self, avatar):
        if self.refuses:
            raise InputError(avatar, "", "a folder that can be written", "Permission denied")
        self.started.append(avatar)
        self.state = "working"

    def progress(self):
        return ("poses", 3, 160) if self.state == "working" else None

    def working(self):
        return self.state == "working"


def test_an_avatar_without_a_surface_is_distilled_once_and_again_where_it_was_trained_anew(file):
    avatars, distiller = Avatars(file), Distiller()
    own = OwnSurface(avatars, distiller)
    for _ in range(3):
        own.tend(file)
    assert distiller.started == [file]
    assert own.words == "distilling: poses 3/160"
    avatars.read(file)  # a session is opened meanwhile
    Path(file).write_bytes(b"and with a surface")
    distiller.state = "finished"
    own.tend(file)
    assert own.words == ""
    own.tend(file)
    assert distiller.started == [file], "its file has not been read anew yet"
    avatars.read(file, "a surface")
    own.tend(file)
    Path(file).write_bytes(b"trained anew")
    avatars.read(file)
    own.tend(file)
    own.tend(file)
    assert distiller.started == [file] * 2


def test_what_was_read_before_its_file_changed_is_not_distilled(file):
    """Another program may have given it a surface."""
    avatars, distiller = Avatars(file), Distiller()
    Path(file).write_bytes(b"and with a surface")
    OwnSurface(avatars, distiller).tend(file)
    assert distiller.started == []


def test_one_that_fails_or_is_refused_is_not_tried_again(file, caplog):
    avatars, distiller = Avatars(file), Distiller()
    own = OwnSurface(avatars, distiller)
    own.tend(file)
    distiller.state = "failed"
    own.tend(file)
    avatars.read(file)
    own.tend(file)
    assert distiller.started == [file]
    own = OwnSurface(Avatars(file), Distiller(refuses=True))
    own.tend(file)
    own.tend(file)
    assert [record.getMessage() for record in caplog.records].count(
        f"{file}: expected a folder that can be written, found Permission denied"
    ) == 1


def test_nothing_is_begun_for_an_avatar_with_a_surface_or_the_packaged_one(file, tmp_path):
    distiller = Distiller()
    OwnSurface(Avatars(file, "a surface"), distiller).tend(file)
    kept = [tmp_path / "runs/me/checkpoints/step_10/avatar", tmp_path / "runs/me/avatars/best.avatar"]
    for path in kept:
        path.parent.mkdir(parents=True)
        path.write_bytes(b"a training keeps it")
    for name in ("default", *map(str, kept)):
        OwnSurface(Avatars(name), distiller).tend(name)
    assert distiller.started == []
