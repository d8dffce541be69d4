"""Recorded keys that say nothing: those that the straight way between their neighbours passes closely enough.

Ramer, Douglas and Peucker's rule: of a run of keys that lead to each other linearly the ends stay, then the one that is farthest off the
way between them, as long as it is farther than `TOLERANCE`, and so on in both halves. Letters: k keys, c 3 or 1 numbers of a key.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from avatarrex_studio.session.keys import CAMERA, LINEAR, ROTATIONS, Key, Place, Tracks
from jaxtyping import Float64
from scipy.spatial.transform import Rotation, Slerp

from avatarrex.signals.joints import EXPRESSION_NAMES

TOLERANCE = {
    **dict.fromkeys(ROTATIONS, np.radians(0.5)), **dict.fromkeys(EXPRESSION_NAMES, 0.01), "translation": 0.002,
    **dict.fromkeys(CAMERA, 0.25), "camera.distance": 0.01, "camera.target": 0.005,
}  # fmt: skip
"""Radians, coefficients, metres; degrees of the camera."""


def redundant(tracks: Tracks, places: tuple[Place, ...]) -> tuple[Place, ...]:
    """Those of some places whose keys can go: at the time of each its track moves by `TOLERANCE` at most. A smooth way beside them may bend
    a little otherwise.
    """
    wanted = set(places)
    found = []
    for track in tracks:
        for run in _linear_runs(track.keys, {time for name, time in wanted if name == track.name}):
            stay = _staying(track.name, run)
            found += [(track.name, key.time) for k, key in enumerate(run) if k not in stay]
    return tuple(found)


def _linear_runs(keys: tuple[Key, ...], wanted: set[float]) -> list[list[Key]]:
    """Runs of keys that lead to each other linearly and are wanted but for their ends."""
    runs = [[keys[0]]]
    for before, key in pairwise(keys):
        if before.curve != LINEAR:
            runs.append([])
        runs[-1].append(key)
        if key.time not in wanted:
            runs.append([key])
    return [run for run in runs if len(run) > 2]


def _staying(name: str, run: list[Key]) -> set[int]:
    """Numbers of the keys that stay."""
    times, values = np.array([key.time for key in run]), np.array([key.value for key in run])
    stay, open_spans = {0, len(run) - 1}, [(0, len(run) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        away = _away(name, times[first : last + 1], values[first : last + 1])
        farthest = 1 + int(np.argmax(away[1:-1]))
        if away[farthest] > TOLERANCE[name]:
            stay.add(first + farthest)
            open_spans += [(first, first + farthest), (first + farthest, last)]
    return stay


def _away(name: str, times: Float64[np.ndarray, " k"], values: Float64[np.ndarray, "k c"]) -> Float64[np.ndarray, " k"]:
    """How far each key is off the straight way from the first to the last."""
    if name in ROTATIONS:
        turned = Rotation.from_rotvec(values)
        way = Slerp(times[[0, -1]], turned[[0, -1]])(times)
        return np.asarray((way.inv() * turned).magnitude())
    share = ((times - times[0]) / (times[-1] - times[0]))[:, None]
    return np.asarray(np.linalg.norm(values - (1 - share) * values[0] - share * values[-1], axis=1))
