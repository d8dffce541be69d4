"""What a window keeps of what has come and gone, counted as objects; and when it gives memory back."""

from __future__ import annotations

import gc
import threading
import weakref
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.engine.avatars import Avatars
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.pages import EVERY, STILL, Resting, give_back, give_pages, keep_pages
from avatarrex_studio.engine.thumbnails import Sitter, Thumbnails
from avatarrex_studio.session.state import StudioState
from ball import render_ball
from surface.template_surface import template_surface

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import avatar_stamp
from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.templates.person import load_person


@pytest.fixture
def files(tmp_path):
    """Two avatars' files, which nobody reads."""
    for name in ("one.avatar", "other.avatar"):
        (tmp_path / name).write_text(name)
    folder = tmp_path / "folder.avatar"
    folder.mkdir()
    (folder / "weights.safetensors").write_text("weights")
    return tmp_path


@pytest.fixture(scope="module")
def untrained():
    return Avatar.create(load_person(), "compact")


class Read:
    """Reads nothing, and counts."""

    def __init__(self, avatar):
        self.avatar, self.names, self.broken = avatar, [], False

    def __call__(self, name):
        self.names.append(name)
        if self.broken or "none" in name:
            raise InputError(name, "", "an avatar", "nothing")
        return replace(self.avatar, meta={"name": name})


@pytest.mark.parametrize("name", ["one.avatar", "folder.avatar"])
def test_the_open_avatar_is_not_read_again_before_its_files_change(files, untrained, name):
    read, path = Read(untrained), files / name
    avatars = Avatars(read)
    assert avatars.stamp(str(path)) == ()
    first = avatars.get(str(path))
    assert avatars.stamp(str(path)) == avatar_stamp(path)
    assert avatars.read(str(path)).result() is first
    avatars.keep(str(path), avatars.read(str(path)))
    assert avatars.ready(str(path)) is first
    assert len(read.names) == 1
    (path / "weights.safetensors" if path.is_dir() else path).write_text("others")
    assert avatars.stamp(str(path)) != avatar_stamp(path)
    again = avatars.read(str(path)).result()
    assert again is not first
    avatars.keep(str(path), avatars.read(str(path)))
    avatars.close()


def test_another_avatar_and_one_that_could_not_be_read_are_read(files, untrained):
    read = Read(untrained)
    avatars = Avatars(read)
    one, other = (str(files / name) for name in ("one.avatar", "other.avatar"))
    avatars.get(one)
    assert avatars.read(other).result().meta["name"] == other
    avatars.get(one)
    assert read.names == [one, other], "what was read beside it takes its place only when it is kept"
    (files / "none.avatar").write_text("")
    avatars.ready(str(files / "none.avatar"))
    avatars._readings[str(files / "none.avatar")].exception()
    for _ in range(2):
        with pytest.raises(InputError):
            avatars.read(str(files / "none.avatar")).result()
    assert read.names[2:] == [str(files / "none.avatar")] * 3
    avatars.close()


def look(avatars, now):
    """One look at the files, and the end of what it began."""
    avatars.notice(now)
    avatars._threads.submit(int).result()


def test_an_open_avatar_is_read_anew_once_its_files_have_changed_and_are_whole(files, untrained, caplog):
    """The one before is there meanwhile, also where the new one cannot be read: that is said once."""
    read, path = Read(untrained), files / "one.avatar"
    avatars = Avatars(read)
    first = avatars.get(str(path))
    for now in range(1, 4):
        look(avatars, now)
    path.write_text("half of the")
    look(avatars, 4)
    path.write_text("half of the rest")
    look(avatars, 5)
    look(avatars, 5.5)
    assert len(read.names) == 1, "it may not be whole yet"
    look(avatars, 6)
    assert (len(read.names), avatars.reading) == (2, False)
    assert avatars.ready(str(path)) is first
    look(avatars, 6.1)
    second = avatars.ready(str(path))
    assert second is not first
    read.broken = True
    path.write_text("no avatar")
    for now in range(7, 12):
        look(avatars, now)
        assert avatars.ready(str(path)) is second
    assert (len(read.names), caplog.text.count("expected an avatar")) == (3, 1)
    with pytest.raises(InputError):
        avatars.read(str(path)).result()
    read.broken = False
    path.write_text("an avatar")
    for now in range(12, 15):
        look(avatars, now)
    assert avatars.ready(str(path)) is not second
    avatars.close()


def test_a_reading_that_was_cancelled_holds_up_no_other(files, untrained):
    going = threading.Event()

    def read(name):
        assert "one" not in name or going.wait(20)
        return replace(untrained)

    avatars = Avatars(read)
    slow = avatars.read(str(files / "one.avatar"))
    avatars.step_aside()
    assert avatars.read(str(files / "other.avatar")).result(20) is not None
    assert not slow.done()
    avatars.step_aside()
    going.set()
    assert slow.result(20) is not None
    avatars.close()


def test_what_waits_behind_a_cancelled_reading_is_not_read_once_all_is_closed(files, untrained):
    going, begun = threading.Event(), threading.Event()

    def read(name):
        begun.set()
        assert going.wait(20)
        return replace(untrained)

    avatars = Avatars(read)
    slow, waiting = (avatars.read(str(files / name)) for name in ("one.avatar", "other.avatar"))
    assert begun.wait(20)
    avatars.step_aside()
    avatars.close()
    going.set()
    assert slow.result(20) is not None
    assert waiting.cancelled()


@pytest.mark.parametrize("name", ["", "nowhere.avatar", "a\0b"])
def test_a_name_without_files_is_always_read(untrained, name):
    read = Read(untrained)
    avatars = Avatars(read)
    avatars.get(name)
    avatars.read(name).result()
    assert len(read.names) == 2 - (name == "")
    avatars.close()


def test_avatars_that_were_replaced_are_gone(files, untrained):
    avatars, alive = Avatars(Read(untrained)), []
    for _ in range(5):
        for name in ("one.avatar", "other.avatar"):
            alive.append(weakref.ref(avatars.get(str(files / name))))
            avatars.all_ready([str(files / name)])
    avatars._threads.submit(int).result()  # the thread lets go of what it read with its next work
    gc.collect()
    assert [reference() is not None for reference in alive] == [False] * 9 + [True]
    assert len(avatars._stamps) == 1
    avatars.close()


def test_an_engine_reads_an_avatar_without_a_surface_again_once_its_file_has_changed(files, untrained):
    read, path = Read(untrained), files / "one.avatar"
    engine = Engine(render=render_ball, load=lambda name, device: read(name))
    state = StudioState(avatar=str(path), level="live")
    for _ in range(3):
        engine.frames(state, state.view.camera(16, 16))
    assert len(read.names) == 1
    path.write_text("with a surface")
    for _ in range(3):
        engine.frames(state, state.view.camera(16, 16))
    assert len(read.names) == 2


def test_thumbnails_keep_no_avatar_of_before(tmp_path, untrained):
    thumbnails = Thumbnails(tmp_path)

    def another():
        avatar = replace(untrained, surface=replace(template_surface(), key="abc"))
        thumbnails.see(avatar)
        thumbnails.want(Sitter("pose", Signals.rest()))
        assert thumbnails.tend() is not None
        return weakref.ref(avatar), weakref.ref(avatar.surface)

    before = another()
    kept = another()
    thumbnails.see(None)
    gc.collect()
    assert [reference() for reference in (*before, *kept)] == [None] * 4


def test_memory_is_given_back_once_after_what_moved(clock):
    given = []
    resting = Resting(clock, lambda: given.append(clock.now))

    def frames(moving, seconds):
        for _ in range(round(seconds / 0.25)):
            clock.now += 0.25
            resting.tend(moving)

    frames(False, 60)
    assert given == [], "nothing moved"
    frames(True, EVERY)
    assert given == []
    frames(False, STILL)
    assert len(given) == 1
    frames(False, 60)
    frames(True, 0.5)
    frames(False, STILL)
    assert len(given) == 2
    for _ in range(20):  # somebody who draws and looks
        frames(True, 0.5)
        frames(False, STILL)
    times = np.diff(given)
    assert len(given) > 3
    assert times.min() >= EVERY


def test_the_library_takes_the_settings():
    """And a thread that allocates goes on meanwhile."""
    stop = threading.Event()

    def work():
        while not stop.is_set():
            bytearray(2**22)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        assert keep_pages()
        assert give_pages()
        bytearray(2**24)
        assert give_back() in (True, False)
    finally:
        stop.set()
        thread.join()
