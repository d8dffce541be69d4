"""Who is put under stress: the packaged avatar, loaded once for each process, also in float64."""

from __future__ import annotations

import copy
from functools import cache

from avatarrex.avatar import Avatar
from avatarrex.avatar_file import load_avatar
from avatarrex.fields.body import BodyField


@cache
def subject() -> Avatar:
    """The packaged avatar."""
    return load_avatar()


@cache
def double_body() -> BodyField:
    """Its body field in float64."""
    return copy.deepcopy(subject().body).double()
