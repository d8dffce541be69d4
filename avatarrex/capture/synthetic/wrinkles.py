"""Pose-dependent wrinkles of cloth: folds that deepen as a joint bends (docs/subject.md).

    Δ(v) = Σ_k a_k(pose) B_k(v)   metres along the rest normal

B_k is a patch of waves around a place on the rest garment (armpit, waist, crotch, knee), a_k ∈ [0, 1] says how far
its joints are from where the cloth lies flat. Both are smooth, so an expression of the field can learn them.

Letters: v vertices, k sites. Rest pose, metres; angles in radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from avatarrex.capture.synthetic.texture import value_noise

TOPS = {"shirt": ("shirt", "tunic"), "trousers": ("trousers",)}
"""Solids that fold where a site says: whatever covers the trunk folds like the shirt."""
Activation = Callable[[np.ndarray], float]


@dataclass(frozen=True)
class Site:
    """One patch of folds."""

    solid: str
    centre: np.ndarray
    radius: np.ndarray
    """(3,) half-widths of the Gaussian patch."""
    across: np.ndarray
    """Unit vector along which the folds follow each other."""
    wavelength: float
    height: float
    activation: Activation
    """Of the (55, 3) rotation vectors."""


def sites(joints: dict[str, np.ndarray], joint_names: tuple[str, ...], crotch: float, armpit: float) -> list[Site]:
    """The folds of the default garments, placed by the rest joints."""
    index = {name: k for k, name in enumerate(joint_names)}

    def bend(*names: str, full: float = 1.4) -> Activation:
        rows = [index[name] for name in names]
        return lambda pose: float(np.tanh((pose[rows] ** 2).sum() / full**2))

    def flex(name: str, full: float) -> Activation:
        return lambda pose: float(np.tanh((pose[index[name], 0] / full) ** 2))

    def add(solid: str, at: np.ndarray, radius: tuple[float, ...], across: tuple[int | float, ...],
            wavelength: float, height: float, activation: Activation) -> None:  # fmt: skip
        unit = np.array(across) / np.linalg.norm(across)
        found.append(Site(solid, at, np.array(radius), unit, wavelength, height, activation))

    def move(point: np.ndarray, *by: int | float) -> np.ndarray:
        return np.asarray(point + np.array(by))

    found: list[Site] = []
    spine = bend("spine1", "spine2", "spine3", full=0.7)
    add("shirt", np.array([0, 0.13, 0.11]), (0.16, 0.10, 0.10), (0.12, 1, 0), 0.048, 0.0055, spine)
    add("shirt", np.array([0, 0.13, -0.10]), (0.16, 0.10, 0.10), (0.12, 1, 0), 0.048, 0.004, spine)
    for side, name in ((1, "left"), (-1, "right")):
        shoulder, knee, hip = (joints[f"{name}_{part}"] for part in ("shoulder", "knee", "hip"))
        raised = bend(f"{name}_shoulder", f"{name}_collar")
        pit = np.array([shoulder[0] - side * 0.02, armpit + 0.02, 0.0])
        add("shirt", move(pit, 0, 0, 0.09), (0.07, 0.075, 0.06), (side, 0.9, 0), 0.042, 0.005, raised)
        add("shirt", move(pit, 0, 0, -0.09), (0.07, 0.075, 0.06), (side, 0.9, 0), 0.042, 0.005, raised)
        add("shirt", move(shoulder, side * 0.03, 0.05, 0), (0.06, 0.05, 0.07), (side, 0.2, 0), 0.036, 0.003, raised)
        bent = flex(f"{name}_knee", 1.2)
        add("trousers", move(knee, 0, 0, -0.06), (0.09, 0.085, 0.05), (0.1 * side, 1, 0), 0.040, 0.006, bent)
        add("trousers", move(knee, 0, 0.08, 0.06), (0.08, 0.05, 0.06), (-0.3 * side, 1, 0), 0.046, 0.003, bent)
        lifted = bend(f"{name}_hip", full=1.2)
        groin = np.array([side * 0.07, crotch + 0.04, hip[2] + 0.10])
        add("trousers", groin, (0.075, 0.07, 0.07), (0.75 * side, 1, 0), 0.044, 0.006, lifted)
        add("trousers", move(groin, side * 0.007, -0.06, -0.20), (0.08, 0.05, 0.06), (0.2, 1, 0), 0.05, 0.004, lifted)
    return found


def basis(site_list: list[Site], rest: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """(v, k) float32 metres: each site's folds at full strength; `solid` (v,) names each vertex's solid."""
    columns = np.zeros((len(rest), len(site_list)), dtype=np.float32)
    for k, site in enumerate(site_list):
        here = np.flatnonzero(np.isin(solid, TOPS[site.solid]))
        offset = rest[here] - site.centre
        patch = np.exp(-((offset / site.radius) ** 2).sum(1))
        phase = 2 * np.pi * (offset @ site.across) / site.wavelength + 2.0 * value_noise(rest[here], 0.06)
        columns[here, k] = site.height * patch * (np.sin(phase) + 0.25 * np.sin(2.1 * phase + 1))
    return columns


def strengths(site_list: list[Site], pose: np.ndarray) -> np.ndarray:
    """(k,) activations in [0, 1) under rotation vectors `pose` (55, 3)."""
    return np.array([site.activation(pose) for site in site_list])
