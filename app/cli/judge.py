"""`avatarrex-studio judge AVATAR CAPTURE OUT_DIR`: blind sheets, the names in a file of their own."""

from __future__ import annotations

import argparse
from argparse import Namespace

from avatarrex_studio.cli import options
from avatarrex_studio.cli.output import output_folder, write_json

from avatarrex.errors import InputError
from avatarrex.files.gate import what_is

MOST_VIEWS = 96


def add_options(verb: argparse.ArgumentParser) -> None:
    """Who is judged, which views, and where the sheets go."""
    add = verb.add_argument
    add("avatar", help="name, folder or .avatar file")
    add("capture", help="a folder or .zip")
    add("out", metavar="OUT_DIR", help="a folder for page_01.png … and key.json, which names A and B of each view")
    add("--other", metavar="AVATAR2", help="who is compared with it (the fitted textured mesh)")
    add("--seed", default="0", metavar="N", help="chooses the views and who is A in each (0)")
    add("--views", default="24", metavar="N", help="how many (24)")
    add("--exposed-as", metavar="RIG", help="pictures as the cameras of this rig would have taken them")
    add("--swap", action="store_true", help="the same views, A and B exchanged")


def run(arguments: Namespace) -> int:
    """Draw the pages and the key. Raises `InputError`."""
    options.refuse_empty(arguments, avatar="AVATAR", capture="CAPTURE", out="OUT_DIR")
    for avatar in filter(None, (arguments.avatar, arguments.other)):
        options.avatar(avatar)
    if (found := what_is(arguments.capture)) not in ("a file", "a folder"):
        raise InputError(arguments.capture, "", "a capture, a folder or a .zip file", found)
    seed = options.whole("--seed", arguments.seed, 0, 2**32 - 1)
    count = options.whole("--views", arguments.views, 1, MOST_VIEWS)
    out = output_folder(arguments.out, "key.json")
    from avatarrex_studio.sheets import blind

    trial = blind.Trial(
        arguments.avatar, arguments.capture, arguments.other, seed, count, arguments.swap, arguments.exposed_as
    )
    write_json(out / "key.json", trial.draw(out))
    return 0
