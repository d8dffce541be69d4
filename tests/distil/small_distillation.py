"""A distillation of the packaged avatar that takes seconds: few triangles and texels, one expression that moves."""

from __future__ import annotations

import pytest

from avatarrex.distil import distil as module
from avatarrex.distil import rest_mesh as mesh_module
from avatarrex.distil.observe import Observation, Observer
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES

TRIANGLES, TEXELS = 2500, 256
OPEN = EXPRESSION_NAMES.index("jawOpen")


def make_small(monkeypatch: pytest.MonkeyPatch) -> list[Signals]:
    """Make `distil` small; the driving signals that it observes from then on."""
    observed: list[Signals] = []
    whole_mesh, whole_texels, observe = module.rest_mesh, module.texels, Observer.observe
    still: dict[int, Observation] = {}

    def counted(self: Observer, signals: Signals) -> Observation:
        observed.append(signals)
        if not signals.expression.any() or signals.expression[OPEN]:
            return observe(self, signals)
        if id(self) not in still:
            still[id(self)] = observe(self, Signals.rest())
        return still[id(self)]

    monkeypatch.setattr(mesh_module, "CELL", 0.016)
    monkeypatch.setattr("avatarrex.distil.hidden.SIDE", 512)
    monkeypatch.setattr(module, "rest_mesh", lambda avatar: whole_mesh(avatar, TRIANGLES))
    monkeypatch.setattr(module, "texels", lambda uv, uv_faces, *size: whole_texels(uv, uv_faces, TEXELS, TEXELS))
    monkeypatch.setattr(module, "BAKED", 1)
    monkeypatch.setattr(module, "surface_errors", lambda avatar, surface: {"depth_mm": 1.25})
    monkeypatch.setattr(Observer, "observe", counted)
    return observed
