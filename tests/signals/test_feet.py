"""What `motion check` says of feet that stand."""

from __future__ import annotations

import numpy as np
import pytest

from avatarrex.signals.contacts import contact_report
from avatarrex.signals.ground import lowest


def test_a_report_of_feet_that_slide_and_sink():
    """Somebody who stands and is drawn forwards by 6 cm a second for a second, 2 cm too low."""
    still = np.zeros((31, 55, 3))
    floor = -lowest(still[:1], np.zeros((1, 3)))[0]
    place = np.zeros((31, 3))
    place[:, 1], place[:, 2] = floor - 0.02, np.linspace(0, 0.06, 31)
    found = contact_report(still, place, 30)
    assert set(found) == {"left", "right"}
    for foot in found.values():
        assert foot.spans == 1
        assert foot.slide == pytest.approx(0.03, abs=1e-3)
        assert 0.015 < foot.sink <= 0.0201
    place[:, 1:] = floor, 0
    firm = contact_report(still, place, 30)["left"]
    assert firm.slide < 1e-9
    assert firm.sink < 1e-6
