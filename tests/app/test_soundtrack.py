"""Sound files of a timeline, and in the videos that are made of it."""

from __future__ import annotations

import wave
from dataclasses import replace

import numpy as np
import pytest
from avatarrex_studio.session.soundtrack import soundtrack
from avatarrex_studio.session.timeline import Clip, Layer, Timeline

from avatarrex.files.video import SOUND_RATE, video_writer

RATE = 16_000


def write_tone(path, hertz, seconds, offset=0.0):
    """A layer of a tone of half the range."""
    times = np.arange(int(RATE * seconds)) / RATE
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE)
        file.writeframes((16384 * np.sin(2 * np.pi * hertz * times)).astype("<i2").tobytes())
    return Layer(path.stem, Clip(str(path), path.stem, int(60 * seconds) + 1, 60.0), offset=offset)


@pytest.fixture
def beep(tmp_path):
    """A layer of half a second of 1 kHz."""
    return write_tone(tmp_path / "beep.wav", 1000, 0.5, 0.25)


def tone(samples):
    """The strongest frequency, hertz, and the root mean square."""
    strength = np.abs(np.fft.rfft(samples))
    return np.fft.rfftfreq(len(samples), 1 / SOUND_RATE)[np.argmax(strength)], np.sqrt(np.mean(samples**2))


def test_a_layer_sounds_where_it_lies(beep):
    sound = soundtrack(Timeline((beep,)), 0.0, 1.0, SOUND_RATE)
    assert len(sound) == SOUND_RATE
    loud = np.abs(sound) > 0.05
    assert np.flatnonzero(loud)[[0, -1]] / SOUND_RATE == pytest.approx([0.25, 0.75], abs=0.002)
    assert tone(sound[int(0.3 * SOUND_RATE) : int(0.7 * SOUND_RATE)]) == pytest.approx((1000, 0.5 / 2**0.5), rel=0.01)
    later = soundtrack(Timeline((beep,)), 0.5, 1.0, SOUND_RATE)
    np.testing.assert_allclose(later[: SOUND_RATE // 2], sound[SOUND_RATE // 2 :], atol=1e-9)


def test_rate_weight_and_loop_count(beep):
    quick = soundtrack(Timeline((replace(beep, rate=2.0, weight=0.5),)), 0.3, 0.15, SOUND_RATE)
    assert tone(quick) == pytest.approx((2000, 0.25 / 2**0.5), rel=0.02)
    slow = replace(beep.clip, fps=30.0)  # the mouth takes twice as long, and so does the sound
    assert tone(soundtrack(Timeline((replace(beep, clip=slow),)), 0.4, 0.8, SOUND_RATE))[0] == pytest.approx(
        500, rel=0.01
    )
    long = replace(beep, name="long", clip=replace(beep.clip, frames=600), muted=True)
    again = soundtrack(Timeline((replace(beep, loop=True), long)), 5.0, 1.0, SOUND_RATE)
    assert tone(again)[1] == pytest.approx(0.5 / 2**0.5, rel=0.05)
    both = soundtrack(Timeline((beep, replace(beep, name="other"))), 0.3, 0.2, SOUND_RATE)
    assert np.abs(both).max() == pytest.approx(1.0, abs=0.01)
    assert soundtrack(Timeline((replace(beep, muted=True),)), 0.0, 1.0, SOUND_RATE) is None
    assert soundtrack(Timeline(), 0.0, 1.0, SOUND_RATE) is None


def test_all_figures_sound_as_they_move(beep):
    """Half a second of 0.75 s, again after 0.767 s where its timeline repeats; one without a loop is silent then."""
    loops, once = Timeline((beep,)), Timeline((replace(beep, rate=2.0),), loop=False)
    both = soundtrack(loops, 0.0, 2.0, SOUND_RATE, (once,))
    assert np.allclose(
        both, (soundtrack(loops, 0.0, 2.0, SOUND_RATE) + soundtrack(once, 0.0, 2.0, SOUND_RATE)).clip(-1, 1)
    )
    beside = soundtrack(Timeline(), 0.0, 2.0, SOUND_RATE, (loops,))
    assert np.array_equal(beside, soundtrack(loops, 0.0, 2.0, SOUND_RATE))
    loud = np.abs(beside) > 0.05
    assert np.flatnonzero(loud[SOUND_RATE * 9 // 10 :])[0] / SOUND_RATE == pytest.approx(0.117, abs=0.02)
    late = slice(SOUND_RATE, None)
    assert not soundtrack(once, 0.0, 2.0, SOUND_RATE)[late].any()


@pytest.mark.parametrize("own", [True, False])
def test_after_the_end_of_what_does_not_repeat_it_is_silent(tmp_path, own):
    """A tone that is loud to its last sample, 0.741 s: of the timeline that leads, or of one beside; before a range, too."""
    layer = write_tone(tmp_path / "tone.wav", 440, 0.741)

    def sounding(**settings):
        timeline = Timeline((layer,), **settings)
        timelines = (timeline, ()) if own else (Timeline(), (timeline,))
        return soundtrack(timelines[0], 0.0, 2.0, SOUND_RATE, timelines[1])

    once, again = sounding(loop=False), sounding()
    end = int(0.741 * SOUND_RATE)
    assert tone(once[: end - 9]) == pytest.approx((440, 0.5 / 2**0.5), rel=0.01), "all of it"
    assert np.abs(once[end - 60 : end - 9]).max() > 0.1
    assert not once[end + 9 :].any()
    assert np.abs(again[SOUND_RATE:]).max() > 0.4
    if not own:
        first = int(0.2 * SOUND_RATE)
        assert not sounding(span=(6, 15))[:first].any()
        ranged = sounding(span=(6, 15), loop=False)
        assert not ranged[: first - 1].any()
        assert np.abs(ranged[int(0.5 * SOUND_RATE) : int(0.53 * SOUND_RATE)]).max() > 0.4, "the last frame of the range"
        assert not ranged[int(0.54 * SOUND_RATE) :].any()


@pytest.mark.parametrize("ending", [".mp4", ".webm"])
def test_a_video_has_the_sound_beside_its_pictures(tmp_path, beep, ending):
    av = pytest.importorskip("av")
    path, sound = tmp_path / f"a{ending}", soundtrack(Timeline((beep,)), 0.0, 2.0, SOUND_RATE)
    with video_writer(path, 32, 16, 12.0, sound) as append:
        for _ in range(12):
            append(np.full((16, 32, 4), 255, np.uint8))
    with av.open(str(path)) as file:
        frames = list(file.decode(audio=0))
        shown = np.concatenate([frame.to_ndarray()[0] for frame in frames])
        start = float(frames[0].pts * frames[0].time_base)
    with av.open(str(path)) as file:
        assert sum(1 for _ in file.decode(video=0)) == 12
    assert len(shown) / SOUND_RATE == pytest.approx(1.0, abs=0.05)  # of two seconds: it ends with the pictures
    middle = slice(int((0.3 - start) * SOUND_RATE), int((0.7 - start) * SOUND_RATE))
    assert tone(shown[middle]) == pytest.approx((1000, 0.5 / 2**0.5), rel=0.05)
    assert np.abs(shown[: int((0.2 - start) * SOUND_RATE)]).max() < 0.02


def test_an_export_of_the_timeline_sounds_and_a_turntable_does_not(tmp_path, beep):
    from avatarrex_studio.jobs.export_look import Look
    from avatarrex_studio.jobs.export_order import VideoOrder
    from avatarrex_studio.session.commands import AddFigure
    from avatarrex_studio.session.state import StudioState

    state = StudioState().change(timeline=Timeline((beep,), frame=9))
    order = VideoOrder(tmp_path / "a.mp4", (state,) * 15, 30.0, Look((64, 64)), plays=True)
    assert tone(order._sound()[: SOUND_RATE // 4])[0] == pytest.approx(1000, rel=0.02)
    assert len(order._sound()) == SOUND_RATE // 2
    assert VideoOrder(tmp_path / "a.mp4", (state,), 30.0, Look((64, 64)))._sound() is None
    beside = AddFigure("default").begun(state.timeline).apply(state)
    beside_it = VideoOrder(tmp_path / "a.mp4", (beside,) * 15, 30.0, Look((64, 64)), plays=True)
    assert tone(beside_it._sound()[: SOUND_RATE // 4])[0] == pytest.approx(1000, rel=0.02), "of the one beside"
