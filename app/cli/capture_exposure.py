"""`capture match-exposure`: a capture whose cameras have one exposure and white balance, with the gains that were found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatarrex.capture.fit.camera_gains import camera_gains, largest
from avatarrex.capture.fit.matched_capture import every_camera, write_matched
from avatarrex.capture.fit.size_fit import fit_size
from avatarrex.capture.readers.rigs import Capture, open_capture
from avatarrex.capture.readers.splits import with_validation
from avatarrex.files.gate import written_folder


def match_exposure(path: str, template: str, out: Path) -> int:
    """Write the capture of the person `template` into the new folder `out`. Raises `InputError`."""
    capture = with_validation(open_capture(path, template=template))
    for note in capture.notes:
        print(note)
    sized = capture if capture.sized else fit_size(capture)
    with written_folder(out) as folder:
        gains = write_matched(sized, folder)
    after = replace(with_validation(open_capture(out, template=template)), person=sized.person)
    for name, found in gains.items():
        left = largest(camera_gains(every_camera(after.rigs[name]), after.person))
        print("\n".join(table(sized, name, found, left)))
    print(out)
    return 0


def table(capture: Capture, name: str, gains: Float[np.ndarray, "k 3"], left: float) -> Iterator[str]:
    """What each camera's pictures are multiplied by; `left`: as much as cameras differ then."""
    views = capture.rigs[name].views
    width = max(len("camera"), *(len(view.name) for view in views))
    yield f"{name:{width}}    red  green   blue"
    for view, gain in zip(views, gains):
        yield f"{view.name:{width}}  " + "  ".join(f"{one:5.3f}" for one in gain)
    yield f"{'':{width}}  at most {largest(gains):.1%} from 1; left after it {left:.1%}"
