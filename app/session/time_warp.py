"""A curve that says how a clip goes through its time: from its beginning to its end, now faster, now slower, back where it falls.

Both are shares of the clip's length, 0 to 1; the ends stay. Between the points is the monotone cubic of Fritsch and Carlson (scipy's
PCHIP): it passes every point and never beyond its neighbours.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from avatarrex.errors import InputError

Warp = tuple[tuple[float, float], ...]
"""When (share of the time that the clip takes) what is shown (share of the file); without both ends."""
MOST, APART = 16, 0.01
"""Points, and shares of time between two."""
WARPS: dict[str, Warp] = {
    "Even": (),
    "Slow start": ((0.5, 0.25),),
    "Slow end": ((0.5, 0.75),),
    "Both slow": ((0.25, 0.12), (0.75, 0.88)),
}
"""By title."""
ENDS = ((0.0, 0.0), (1.0, 1.0))


def check(source: str, warp: Warp) -> None:
    """Raise `InputError` where it is no curve."""
    points = (ENDS[0], *warp, ENDS[1])
    finite = all(
        len(point) == 2 and all(isinstance(x, int | float) and math.isfinite(x) for x in point) for point in warp
    )
    if not finite or len(warp) > MOST or any(not 0 <= value <= 1 for _, value in warp):
        raise InputError(source, "warp", f"at most {MOST} points of two shares from 0 to 1", warp)
    if any(later[0] - earlier[0] < APART - 1e-9 for earlier, later in itertools.pairwise(points)):
        raise InputError(source, "warp", f"points in order of time, {APART} apart and from the ends", warp)


def warped(warp: Warp, share: float | Float[np.ndarray, "..."]) -> np.ndarray:
    """The share of the file at shares of the time; beyond the ends as if there were no curve."""
    inside = np.clip(share, 0.0, 1.0)
    return np.asarray(_curve(warp)(inside) + (np.asarray(share) - inside))


@lru_cache(maxsize=64)
def _curve(warp: Warp) -> Any:
    from scipy.interpolate import PchipInterpolator  # takes 0.3 s: not before there is a curve

    return PchipInterpolator(*zip(*(ENDS[0], *warp, ENDS[1])))
