"""`capture match-exposure`: a capture whose cameras have one exposure and white balance, with the gains that were found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatarrex.capture.fit.camera_gains import largest
from avatarrex.capture.fit.matched_capture import gains_of_all, write_matched
from avatarrex.capture.fit.size_fit import fit_size
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.errors import check
from avatarrex.files.gate import written_folder


def match_exposure(path: str, template: str, out: Path) -> int:
    """Write the capture of the person `template` into the new folder `out`. Raises `InputError`."""
    out = out.absolute()
    inside = out.resolve().is_relative_to(Path(path).resolve())
    check(not inside, out, "", "a folder outside the capture", "one inside it")
    with written_folder(out) as folder:
        capture = with_validation(open_capture(path, template=template))
        for note in capture.notes:
            print(note)
        sized = capture if capture.sized else fit_size(capture)
        gains = write_matched(sized, folder)
    after = with_validation(open_capture(out, template=template))
    after = replace(after.moved(sized.pelvis - after.pelvis), person=sized.person)
    for name, found in gains.items():
        left = gains_of_all(after.rigs[name], after.person)
        print("\n".join(table(sized.rigs[name], found, left)))
    print(out)
    return 0


def table(rig: Rig, gains: Float[np.ndarray, "k 3"], left: Float[np.ndarray, "k 3"]) -> Iterator[str]:
    """What each camera's pictures are multiplied by, and how much they differ before and after it."""
    width = max(len("camera"), *(len(view.name) for view in rig.views))
    yield f"{rig.name:{width}}    red  green   blue"
    for view, gain in zip(rig.views, gains):
        factors = "  ".join(f"{one:5.3f}" for one in gain)
        known = np.isfinite(gain).all()
        yield f"{view.name:{width}}  {factors if known else 'as it was: shares too little with the others'}"
    if np.isfinite(gains).any():
        yield f"{'':{width}}  at most {largest(gains):.1%} from 1; left after it {largest(left):.1%}"
