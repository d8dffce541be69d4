"""`avatarrex-studio distil AVATAR`: the surface of an avatar, made of its fields; goes on where it was stopped."""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avatarrex_studio.cli import options
from avatarrex_studio.cli.output import output_folder, print_figures
from avatarrex_studio.jobs.distilling import POSES, parent_ended, refuse_another, work_folder

from avatarrex.errors import InputError
from avatarrex.files.gate import check_writable, remove_unfinished
from avatarrex.training.runs.control import Heart, Heartbeat

if TYPE_CHECKING:
    from avatarrex.avatar import Avatar
    from avatarrex.surface.surface import Surface

FEWEST, MOST = 4, 999
"""Poses that corrections can be fitted to, and that file names count."""


def add_options(verb: argparse.ArgumentParser) -> None:
    """The avatar, and where it goes."""
    add = verb.add_argument
    add("avatar", help="an avatar folder, an .avatar file, or default (with --out)")
    add("--out", metavar="OUT", help="the avatar with its surface: a folder or OUT.avatar (in place)")
    add("--poses", metavar="N", help=f"poses that it is fitted to, {FEWEST} to {MOST} (160)")
    options.add_device(verb)


def run(arguments: argparse.Namespace) -> int:
    """Distil, store, print the figures. Raises `InputError`: what cannot be written is refused before any work."""
    options.refuse_empty(arguments, avatar="AVATAR")
    source = options.avatar(arguments.avatar)
    poses = options.whole("--poses", arguments.poses, FEWEST, MOST) if arguments.poses is not None else None
    target = _target(source, arguments.out)
    folder = work_folder(target)
    refuse_another(folder)
    from avatarrex.avatar_file import load_avatar, store_surface

    avatar = load_avatar(source, arguments.device)
    surface = _distil(avatar, folder, poses)
    store_surface(source, surface, target)
    shutil.rmtree(folder)
    if target.is_dir():
        remove_unfinished(target, below=False)
    print_figures(surface.meta)
    print(target)
    return 0


def _target(source: str, out: str | None) -> Path:
    """Where the avatar with its surface goes, which can be written."""
    if out is None:
        if source == "default":
            raise InputError("--out", "", "OUT.avatar with it: the packaged avatar stays as it is", "nothing")
        if (Path(source).absolute().parent / "manifest.json").exists():
            raise InputError("--out", "", "OUT.avatar with it: a checkpoint stays as it is", "nothing")
    target = Path(source if out is None else out)
    if target.is_file() and target.suffix != ".avatar":
        raise InputError(target, "", "a folder, or a file that ends in .avatar", target.name)
    if target.suffix == ".avatar" and not target.is_dir():
        check_writable(target)
        return target
    return output_folder(str(target), "surface.safetensors")


def _distil(avatar: Avatar, folder: Path, poses: int | None) -> Surface:
    """With bars on the terminal and a heartbeat in the folder."""
    from avatarrex.distil import distil
    from avatarrex.distil.progress_bars import ProgressBars

    now: dict[str, Any] = {"pass_name": "", "step": 0, "steps": 0}

    def note(what: str, done: int, of: int) -> None:
        if not now["pass_name"] and (kept := sum(1 for _ in (folder / POSES).glob("*.npz"))):
            print(f"{folder}: going on, {kept} observations are there", flush=True)
        now.update(pass_name=what, step=done, steps=of)
        if parent_ended():
            raise KeyboardInterrupt

    folder.mkdir(parents=True, exist_ok=True)
    heart = Heart(folder, lambda: Heartbeat(time.time(), os.getpid(), socket.gethostname(), "surface", **now))
    heart.beat()
    heart.start()
    try:
        with ProgressBars(note) as bars:
            count = distil.POSES if poses is None else poses
            return distil.distil(avatar, folder / POSES, count, bars)
    finally:
        heart.stop()
        (folder / "heartbeat.json").unlink(missing_ok=True)
