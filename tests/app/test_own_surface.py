"""The window gives an avatar without a surface one, in the background, once."""

from __future__ import annotations

from avatarrex_studio.window.own_surface import OwnSurface

from avatarrex.errors import InputError


class Avatar:
    def __init__(self, surface):
        self.surface = surface


class Avatars:
    def __init__(self, surface=None):
        self.avatar = Avatar(surface)

    def ready(self, name):
        return self.avatar


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


def test_an_avatar_without_a_surface_is_distilled_once_and_again_where_it_was_trained_anew():
    avatars, distiller = Avatars(), Distiller()
    own = OwnSurface(avatars, distiller)
    for _ in range(3):
        own.tend("me.avatar")
    assert distiller.started == ["me.avatar"]
    assert own.words == "distilling: poses 3/160"
    distiller.state = "finished"
    own.tend("me.avatar")
    assert own.words == ""
    own.tend("me.avatar")
    assert distiller.started == ["me.avatar"], "its file has not been read anew yet"
    avatars.avatar = Avatar("a surface")
    own.tend("me.avatar")
    avatars.avatar = Avatar(None)
    own.tend("me.avatar")
    own.tend("me.avatar")
    assert distiller.started == ["me.avatar"] * 2


def test_one_that_fails_or_is_refused_is_not_tried_again(caplog):
    avatars, distiller = Avatars(), Distiller()
    own = OwnSurface(avatars, distiller)
    own.tend("me.avatar")
    distiller.state = "failed"
    own.tend("me.avatar")
    own.tend("me.avatar")
    assert distiller.started == ["me.avatar"]
    own = OwnSurface(Avatars(), Distiller(refuses=True))
    own.tend("me.avatar")
    own.tend("me.avatar")
    assert [record.getMessage() for record in caplog.records].count(
        "me.avatar: expected a folder that can be written, found Permission denied"
    ) == 1


def test_nothing_is_begun_for_an_avatar_with_a_surface_or_the_packaged_one():
    distiller = Distiller()
    OwnSurface(Avatars("a surface"), distiller).tend("me.avatar")
    for name in ("default", "runs/me/checkpoints/step_10/avatar", "runs/me/avatars/best.avatar"):
        OwnSurface(Avatars(), distiller).tend(name)
    assert distiller.started == []
