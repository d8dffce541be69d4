"""A skeleton's motion on the 55 joints: names, axes, rest pose, size, floor.

With R the file's global rotation of a joint (the identity at rest) and W the rotation from the file's world to ours
(world_axes.py), ours is W · R · B: B of each joint is how it rests in the file, from its rest pose (rest_pose.py) or, where that
is a bundle of bones, from bones and averages (bone_frames.py). Every limb bone then points exactly where the file's does. The spine
is turned, on top, until hips to neck points where the file's does. Letters: t frames, j joints. Rotation matrices; the file's unit,
then metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from avatarrex.errors import InputError
from avatarrex.signals.bone_frames import BoneFrames
from avatarrex.signals.contacts import locked
from avatarrex.signals.direction import smallest_turn
from avatarrex.signals.fidelity import Fidelity
from avatarrex.signals.ground import WORDS, grounded
from avatarrex.signals.import_options import UNITS, ImportOptions
from avatarrex.signals.imported import Guess, ImportedMotion, Skeleton, feet
from avatarrex.signals.joint_names import NEEDED, find
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.limits import LIMITS
from avatarrex.signals.rest_pose import dangling, rest_axes, rest_turns
from avatarrex.signals.rest_skeleton import rest_skeleton
from avatarrex.signals.sequence import SignalSequence, stack
from avatarrex.signals.source_motion import SourceMotion
from avatarrex.signals.suspicion import suspicions
from avatarrex.signals.world_axes import near_axis, world_axes

_INDEX = {name: j for j, name in enumerate(JOINT_NAMES)}
_TOES = [_INDEX["left_foot"], _INDEX["right_foot"]]
_STILL = np.radians(0.01)
"""A joint that never turns by more than this is at rest: exporters write 1e-5 degrees where nothing moves."""
_UNIT_SLACK = 1.3
"""A leg of 0.66 to 1.12 m: everybody above 1.4 m. Units lie farther apart than its square, but for CMU's and decimetres."""
_LEG = ("left_hip", "left_knee", "left_ankle")


@dataclass(frozen=True, eq=False)
class _Rest:
    """How a file rests: B (55, 3, 3) of each joint; `axes` (3, 3) to ours, None for a bundle of bones."""

    turns: np.ndarray
    axes: np.ndarray | None
    guess: Guess


def retarget(path: Path, source: SourceMotion, options: ImportOptions) -> ImportedMotion:
    """Our signals of a file's motion. Raises `InputError` if a limb is missing or an option does not fit."""
    found = find(source.names, source.parents, path, options.joints)
    for name in NEEDED:
        if name not in found:
            raise InputError(path, "HIERARCHY", f"a joint for {name}", ", ".join(source.names[:12]))
    axes = None if options.rest == "bones" else rest_axes(source, found, options.rest == "pose")
    if options.rest == "pose" and axes is None:
        raise InputError(path, "rest", "a pose whose hips lie across the trunk (or bones)", "one line for both")
    world, axis_guesses, warnings = world_axes(path, source, found, axes, options)
    rest = _rest(source, found, axes, world, options)
    globals_ = _globals(source.turned, world, rest.turns, found)
    _straighten(globals_, source.places @ world.T, found)
    pose = _locals(globals_)
    errors = Fidelity(source, found, world, axes, *rest_skeleton().posed(pose)).errors()
    fps, rate = _rate(source, options)
    scale, unit = _scale(source, found, options)
    places = (source.places - _hips(source.places[:1], found)) @ world.T * scale
    path_metres = _hips(places, found)[:, 0]
    warnings += suspicions(pose, path_metres, fps)
    limited = np.clip(pose[:, _TOES], LIMITS[_TOES, :, 0], LIMITS[_TOES, :, 1])
    toes, pose[:, _TOES] = int((np.abs(limited - pose[:, _TOES]).max((1, 2)) > 1e-9).sum()), limited
    still = np.ptp(places[:, source.parents < 0, 1]) < 1e-3 and len(pose) > 1
    how, why = (
        (options.floor, "chosen")
        if options.floor
        else ("each", "the root never rises or sinks")
        if still
        else ("contacts", "")
    )
    moved = grounded(pose, path_metres, how, fps)
    if options.lock_feet:
        pose = locked(pose, moved, fps)
    guesses = (
        Guess("file", source.dialect, f"{len(pose)} frames, {len(source.names)} joints and ends"), unit, *axis_guesses, rest.guess,
        rate, Guess("floor", WORDS[how], why, "floor"), feet(options), *_joint_guesses(found, toes),
    )  # fmt: skip
    skeleton = Skeleton(source.names, source.parents, places + (moved - path_metres)[:, None], _names(source, found))
    skeleton.places[..., 1] += _hip_height()
    notes = (*map(str, guesses), *(f"warning: {text}" for text in warnings))
    sequence = SignalSequence(stack(pose, moved), fps, path.name, notes)
    return ImportedMotion(sequence, guesses, tuple(warnings), skeleton, errors, options)


def _rest(
    source: SourceMotion, found: dict[str, int], axes: np.ndarray | None, world: np.ndarray, options: ImportOptions
) -> _Rest:
    """B of each joint, and the table's line."""
    bones, chosen = BoneFrames(source, found, world[1]), "chosen; " if options.rest else ""
    if axes is None:
        why = f"{chosen}their directions and averages count"
        return _Rest(bones.all(), None, Guess("rest pose", "a bundle of bones", why, "rest"))
    turns, odd = rest_turns(source, found, axes), dangling(source, found, axes)
    if odd:
        bones.turns.update(zip(JOINT_NAMES, turns))
        for name in odd:
            side, _, part = name.partition("_")
            bones.foot(side) if part == "ankle" else bones.collar(side)
        turns = np.stack([bones.turns[name] for name in JOINT_NAMES])
    letters = [near_axis(row) for row in axes]
    why = f"{chosen}left, up, forward are {', '.join(letters)}" + (f"; by their bones: {', '.join(odd)}" if odd else "")
    return _Rest(turns, axes, Guess("rest pose", "a person's", why, "rest"))


def _globals(turned: np.ndarray, world: np.ndarray, rest: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """(t, 55, 3, 3): ours; a joint that the file lacks follows its parent."""
    globals_ = np.zeros((len(turned), 55, 3, 3))
    for j, (name, parent) in enumerate(zip(JOINT_NAMES, rest_skeleton().parents)):
        if name in found:
            globals_[:, j] = world @ turned[:, found[name]] @ rest[j]
        else:
            globals_[:, j] = globals_[:, parent] @ (rest[parent].T @ rest[j])
    return globals_


def _straighten(globals_: np.ndarray, places: np.ndarray, found: dict[str, int]) -> None:
    """Turn the spine until hips to neck points where the file's does: spines differ in curve and in where they bend."""
    if "neck" not in found:
        return
    ours, parents = rest_skeleton().joints, rest_skeleton().parents
    wanted = places[:, found["neck"]] - (places[:, found["left_hip"]] + places[:, found["right_hip"]]) / 2
    chain = [_INDEX[name] for name in ("spine1", "spine2", "spine3", "neck")]
    hips = (ours[_INDEX["left_hip"]] + ours[_INDEX["right_hip"]]) / 2 - ours[0]
    # the pelvis' own share does not turn: three rounds leave less than 0.1 degrees
    for _ in range(3):
        have = -globals_[:, 0] @ hips
        for j in chain:
            have = have + globals_[:, parents[j]] @ (ours[j] - ours[parents[j]])
        globals_[:, chain[:3]] = smallest_turn(have, wanted)[:, None] @ globals_[:, chain[:3]]


def _locals(globals_: np.ndarray) -> np.ndarray:
    """(t, 55, 3) rotation vectors relative to the parents."""
    local = globals_.copy()
    local[:, 1:] = np.swapaxes(globals_[:, rest_skeleton().parents[1:]], 2, 3) @ globals_[:, 1:]
    pose: np.ndarray = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 55, 3)
    pose[:, np.linalg.norm(pose, axis=2).max(0) < _STILL] = 0
    return pose


def _hips(places: np.ndarray, found: dict[str, int]) -> np.ndarray:
    """(t, 1, 3) between the hips."""
    return np.asarray((places[:, [found["left_hip"]]] + places[:, [found["right_hip"]]]) / 2)


def _hip_height() -> float:
    """y of the middle of our hips in metres, at rest."""
    return float(rest_skeleton().joints[[_INDEX["left_hip"], _INDEX["right_hip"]], 1].mean())


def _length(joints: np.ndarray, chain: list[int]) -> float:
    """Length of the bones along a chain of joints."""
    return float(np.linalg.norm(np.diff(joints[chain], axis=0), axis=1).sum())


def _scale(source: SourceMotion, found: dict[str, int], options: ImportOptions) -> tuple[float, Guess]:
    """Metres of the file's unit on our person, and what the unit seems to be."""
    leg = [name for name in _LEG if name in found]
    theirs = _length(source.places[0], [found[name] for name in leg])
    scale = _length(rest_skeleton().joints, [_INDEX[name] for name in leg]) / max(theirs, 1e-12)
    if options.metres is not None:
        return options.metres, Guess("unit", options.unit, f"chosen; our leg would say {scale:.4g} m", "unit")
    name, metres = min(UNITS.items(), key=lambda unit: abs(np.log(unit[1] / scale)))
    fits = max(metres / scale, scale / metres) < _UNIT_SLACK
    size = f"{metres / scale:.2f} times our leg" if fits else "no unit makes a grown person"
    return scale, Guess("unit", name if fits else "unknown", f"{size}; path scaled by {scale:.4g} to our leg", "unit")


def _rate(source: SourceMotion, options: ImportOptions) -> tuple[float, Guess]:
    if options.fps is not None:
        return options.fps, Guess(
            "rate", f"{options.fps:g} frames a second", f"chosen; the file says {source.fps:g}", "fps"
        )
    return source.fps, Guess("rate", f"{source.fps:g} frames a second", "", "fps")


def _joint_guesses(found: dict[str, int], toes: int) -> tuple[Guess, ...]:
    """What the file has of our joints."""
    body = [name for name in JOINT_NAMES[:25] if name not in found]
    fingers = sum(name in found for name in JOINT_NAMES[25:])
    guesses = [
        Guess(
            "joints",
            f"{25 - len(body)} of 25",
            f"not in the file, at rest: {', '.join(body)}" if body else "",
            "joints",
        )
    ]
    guesses.append(
        Guess("fingers", f"{fingers} of 30", "" if fingers else "no finger joints in the file: flat hands", "joints")
    )
    if toes:
        guesses.append(Guess("toes", f"limited in {toes} frames", "they bent as no toes do"))
    return tuple(guesses)


def _names(source: SourceMotion, found: dict[str, int]) -> dict[str, str]:
    return {name: source.names[k] for name, k in found.items()}
