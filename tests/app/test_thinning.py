"""Recorded keys are thinned out without a visible change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from avatarrex_studio.session.keys import LINEAR, SMOOTH, Key, Track, without
from avatarrex_studio.session.thinning import TOLERANCE, redundant
from scipy.spatial.transform import Rotation


def recorded(name, values, curve=LINEAR):
    """A track with thirty keys a second."""
    return Track(name, tuple(Key(k / 30, tuple(map(float, value)), curve) for k, value in enumerate(values)))


def places(*tracks):
    return tuple((track.name, key.time) for track in tracks for key in track.keys)


def test_what_the_others_say_goes_and_the_curve_stays():
    times = np.arange(90) / 30
    turning = np.stack([1.2 * np.sin(times), 0.3 * times, 0.0 * times], 1)
    elbow, smile = recorded("left_elbow", turning), recorded("jawOpen", np.abs(times - 1.5)[:, None] / 1.5)
    tracks = (elbow, smile)
    thin = without(tracks, redundant(tracks, places(*tracks)))
    assert 4 < len(thin[0].keys) < 25
    assert [key.time for key in thin[1].keys] == [0, 1.5, times[-1]]  # two straight lines
    assert thin[0].keys[0] == elbow.keys[0]
    assert thin[0].keys[-1] == elbow.keys[-1]
    apart = [(Rotation.from_rotvec(elbow.at(t)).inv() * Rotation.from_rotvec(thin[0].at(t))).magnitude() for t in times]
    assert 0 < max(apart) <= TOLERANCE["left_elbow"] + 1e-9


def test_what_was_not_chosen_or_is_no_line_stays():
    flat = recorded("translation", np.zeros((10, 3)))
    chosen = places(flat)[:6]
    left = without((flat,), redundant((flat,), chosen))[0]
    assert [round(30 * key.time) for key in left.keys] == [0, 6, 7, 8, 9]
    smooth = recorded("translation", np.zeros((10, 3)), SMOOTH)
    assert redundant((smooth,), places(smooth)) == ()
    bent = replace(flat, keys=(*flat.keys[:4], replace(flat.keys[4], curve=SMOOTH), *flat.keys[5:]))
    left = without((bent,), redundant((bent,), places(bent)))[0]
    assert [round(30 * key.time) for key in left.keys] == [0, 4, 5, 9]
