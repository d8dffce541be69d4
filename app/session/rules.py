"""What each command does: the pure `apply(state, command) -> state`, one rule per command (commands.py)."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import singledispatch

import numpy as np
from avatarrex_studio.session import commands, posing
from avatarrex_studio.session.commands import Command
from avatarrex_studio.session.state import MotionState, OrbitView, SizePolicy, StudioState

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import mirror, named_expression, named_hand, named_pose
from avatarrex.signals.limits import random_signals


def apply(state: StudioState, command: Command) -> StudioState:
    """The state after `command`. Raises `InputError` for a value that cannot be set."""
    return _apply(command, state)


@singledispatch
def _apply(command: Command, state: StudioState) -> StudioState:
    raise TypeError(f"no rule for {type(command).__name__}")


@_apply.register
def _(command: commands.SetJoint, state: StudioState) -> StudioState:
    return _pose(state, posing.set_joint(state.signals, command.joint, command.rotation, state.limit_joints))


@_apply.register
def _(command: commands.SetTranslation, state: StudioState) -> StudioState:
    return _pose(state, state.signals.replace(translation=np.array(command.translation)))


@_apply.register
def _(command: commands.SetExpression, state: StudioState) -> StudioState:
    value = float(np.clip(command.value, 0, 1)) if state.limit_joints else command.value
    return _pose(state, posing.set_expression(state.signals, command.name, value))


@_apply.register
def _(command: commands.SetShape, state: StudioState) -> StudioState:
    shape = state.signals.shape.copy()
    if not 0 <= command.index < len(shape):
        raise InputError("shape", "", f"a coefficient from 0 to {len(shape) - 1}", command.index)
    shape[command.index] = command.value
    return _pose(state, state.signals.replace(shape=shape))


@_apply.register
def _(command: commands.SetHandPose, state: StudioState) -> StudioState:
    if command.side not in ("left", "right"):
        raise InputError("hand", "", "left or right", command.side)
    pose = named_hand(command.name, command.side)
    return _pose(state, state.signals.replace(**{f"{command.side}_hand_pose": pose}))


@_apply.register
def _(command: commands.ApplyPose, state: StudioState) -> StudioState:
    return _pose(state, state.signals.replace(body_pose=named_pose(command.name)))


@_apply.register
def _(command: commands.ApplyExpression, state: StudioState) -> StudioState:
    return _pose(state, state.signals.replace(expression=named_expression(command.name)))


@_apply.register
def _(command: commands.SetSignals, state: StudioState) -> StudioState:
    return _pose(state, command.signals)


@_apply.register
def _(command: commands.Randomise, state: StudioState) -> StudioState:
    drawn = random_signals(np.random.default_rng(command.seed), command.strength)
    return _pose(state, posing.copy_group(state.signals, drawn, command.group))


@_apply.register
def _(command: commands.Mirror, state: StudioState) -> StudioState:
    return _pose(state, mirror(state.signals).replace(translation=state.signals.translation))


@_apply.register
def _(command: commands.Reset, state: StudioState) -> StudioState:
    return _pose(state, Signals.rest())


@_apply.register
def _(command: commands.ResetGroup, state: StudioState) -> StudioState:
    return _pose(state, posing.reset(state.signals, command.group))


@_apply.register
def _(command: commands.SetLimits, state: StudioState) -> StudioState:
    return state.change(limit_joints=command.limited)


@_apply.register
def _(command: commands.OrbitBy, state: StudioState) -> StudioState:
    view = state.view
    azimuth = (view.azimuth + command.azimuth + 180) % 360 - 180
    elevation = float(np.clip(view.elevation + command.elevation, -89, 89))
    return state.change(view=replace(view, azimuth=azimuth, elevation=elevation))


@_apply.register
def _(command: commands.PanBy, state: StudioState) -> StudioState:
    view = state.view
    azimuth, elevation = np.radians([view.azimuth, view.elevation])
    right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    up = np.array([-np.sin(azimuth) * np.sin(elevation), np.cos(elevation), -np.cos(azimuth) * np.sin(elevation)])
    height = 2 * view.distance * np.tan(np.radians(view.fov) / 2)
    return state.change(view=_moved(view, height * (command.right * right + command.up * up)))


@_apply.register
def _(command: commands.ZoomBy, state: StudioState) -> StudioState:
    distance = float(np.clip(state.view.distance * command.factor, 0.3, 50))
    return state.change(view=replace(state.view, distance=distance))


@_apply.register
def _(command: commands.SetCamera, state: StudioState) -> StudioState:
    given = {item.name: getattr(command, item.name) for item in dataclasses.fields(command)}
    view = replace(state.view, **{name: value for name, value in given.items() if value is not None})
    return state.change(view=view)


@_apply.register
def _(command: commands.SetBackground, state: StudioState) -> StudioState:
    return state.change(background=command.colour)


@_apply.register
def _(command: commands.SetSize, state: StudioState) -> StudioState:
    return state.change(size=SizePolicy(command.scale, command.fixed))


@_apply.register
def _(command: commands.SetHidden, state: StudioState) -> StudioState:
    part = {command.part}
    return state.change(hidden=state.hidden | part if command.hidden else state.hidden - part)


@_apply.register
def _(command: commands.SetLevel, state: StudioState) -> StudioState:
    return state.change(level=command.level)


@_apply.register
def _(command: commands.OpenAvatar, state: StudioState) -> StudioState:
    return state.change(avatar=command.avatar)


@_apply.register
def _(command: commands.LoadMotion, state: StudioState) -> StudioState:
    motion = MotionState(command.path, command.name, command.frames, command.fps)
    return _played(state.change(motion=motion), command.signals)


@_apply.register
def _(command: commands.SetFrame, state: StudioState) -> StudioState:
    if state.motion is None:
        raise InputError("frame", "", "a motion to be loaded first", command.frame)
    return _played(state.change(motion=replace(state.motion, frame=command.frame)), command.signals)


@_apply.register
def _(command: commands.CloseMotion, state: StudioState) -> StudioState:
    return state.change(motion=None)


def _pose(state: StudioState, signals: Signals) -> StudioState:
    return state.change(signals=signals)


def _played(state: StudioState, signals: Signals) -> StudioState:
    """A motion's signals, the avatar's own shape; the view goes along over the ground."""
    step = (signals.translation - state.signals.translation) * (1, 0, 1)
    view = _moved(state.view, step) if state.view.follow else state.view
    return state.change(signals=signals.replace(shape=state.signals.shape), view=view)


def _moved(view: OrbitView, step: np.ndarray) -> OrbitView:
    x, y, z = np.asarray(view.target) + step
    return replace(view, target=(float(x), float(y), float(z)))
