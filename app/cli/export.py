"""`avatarrex-studio export AVATAR OUT`: an avatar for other programs, by the ending of OUT. A wrong option needs no torch."""

from __future__ import annotations

import argparse
from argparse import Namespace

from avatarrex_studio.cli import options
from avatarrex_studio.cli.motion_options import KINDS
from avatarrex_studio.cli.output import name_files

from avatarrex.errors import InputError
from avatarrex.export.clips import read_clips
from avatarrex.export.target import ENDINGS, check_export


def add_options(verb: argparse.ArgumentParser) -> None:
    """The avatar, the file, and what moves in it."""
    add = verb.add_argument
    add("avatar", help="name, folder or .avatar file")
    add("out", metavar="OUT", help="a file that ends in " + ", ".join(ENDINGS))
    motions = KINDS
    add("--motion", action="append", default=[], metavar="FILE", help=f"a clip: {motions}; several times for several")
    add(
        "--pose",
        action="append",
        default=[],
        metavar="NAME",
        help="a clip of one frame: a named pose; what .obj and .ply show",
    )


def run(arguments: Namespace) -> int:
    """Write, say what is lost, name the files. Raises `InputError`."""
    options.refuse_empty(arguments, avatar="AVATAR", out="OUT")
    for option in ("motion", "pose"):
        if "" in getattr(arguments, option):
            raise InputError(f"--{option}", "", "a value", "nothing")
    options.avatar(arguments.avatar)
    check_export(arguments.out, len(arguments.motion) + len(arguments.pose))
    clips = read_clips(arguments.motion, arguments.pose)
    check_export(arguments.out, len(clips), len(clips[0]) if clips else 1)
    from avatarrex.avatar_file import load_avatar
    from avatarrex.export.export import export_avatar

    avatar = load_avatar(arguments.avatar)
    if avatar.surface is None:
        remedy = f"an avatar with a surface (avatarrex-studio distil {arguments.avatar} makes it)"
        raise InputError(arguments.avatar, "surface", remedy, "none")
    exported = export_avatar(avatar, arguments.out, clips)
    print("\n".join(exported.label.lines()))
    for name in exported.label.missing:
        print(f"note: this avatar does not state its {name}, and the file says so")
    name_files(exported.files)
    return 0
