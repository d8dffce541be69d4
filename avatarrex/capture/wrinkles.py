"""Pose-dependent wrinkles of cloth: folds that deepen as a joint bends (default_person.md, 'The clothed subject').

    Δ(v) = Σ_k a_k(pose) B_k(v)   metres along the rest normal

B_k is a patch of waves around a place on the rest garment (armpit, waist, crotch, knee), a_k ∈ [0, 1] says how far its joints
are from where the cloth lies flat. Both are smooth, so an expression of the field can learn them.

Letters: v vertices, k sites. Rest pose, metres; angles in radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from avatarrex.capture.texture import value_noise

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
        return lambda pose: float(np.tanh(np.linalg.norm(pose[rows], axis=1).sum() / full))

    def flex(name: str, full: float) -> Activation:
        return lambda pose: float(np.tanh(abs(pose[index[name], 0]) / full))

    def unit(*v: float) -> np.ndarray:
        return np.array(v) / np.linalg.norm(v)

    found = []
    spine = bend("spine1", "spine2", "spine3", full=0.7)
    for z, height in ((0.11, 0.0055), (-0.10, 0.004)):
        found.append(
            Site("shirt", np.array([0, 0.13, z]), np.array([0.16, 0.10, 0.10]), unit(0.12, 1, 0), 0.048, height, spine)
        )
    for side, name in ((1, "left"), (-1, "right")):
        shoulder, knee, hip = (joints[f"{name}_{part}"] for part in ("shoulder", "knee", "hip"))
        raised = bend(f"{name}_shoulder", f"{name}_collar")
        pit = np.array([shoulder[0] - side * 0.02, armpit + 0.02, 0.0])
        for z in (0.09, -0.09):
            found.append(
                Site("shirt", pit + [0, 0, z], np.array([0.07, 0.075, 0.06]), unit(side, 0.9, 0), 0.042, 0.005, raised)
            )
        top = shoulder + [side * 0.03, 0.05, 0]
        found.append(Site("shirt", top, np.array([0.06, 0.05, 0.07]), unit(side, 0.2, 0), 0.036, 0.003, raised))
        bent = flex(f"{name}_knee", 1.2)
        found.append(
            Site(
                "trousers",
                knee + [0, 0, -0.06],
                np.array([0.09, 0.085, 0.05]),
                unit(0.1 * side, 1, 0),
                0.040,
                0.006,
                bent,
            )
        )
        found.append(
            Site(
                "trousers",
                knee + [0, 0.08, 0.06],
                np.array([0.08, 0.05, 0.06]),
                unit(-0.3 * side, 1, 0),
                0.046,
                0.003,
                bent,
            )
        )
        lifted = bend(f"{name}_hip", full=1.2)
        groin = np.array([side * 0.07, crotch + 0.04, hip[2] + 0.10])
        found.append(
            Site("trousers", groin, np.array([0.075, 0.07, 0.07]), unit(0.75 * side, 1, 0), 0.044, 0.006, lifted)
        )
        found.append(
            Site(
                "trousers",
                groin * [1.1, 1, 1] + [0, -0.06, -0.20],
                np.array([0.08, 0.05, 0.06]),
                unit(0.2, 1, 0),
                0.05,
                0.004,
                lifted,
            )
        )
    return found


def basis(site_list: list[Site], rest: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """(v, k) float32 metres: each site's folds at full strength; `solid` (v,) names each vertex's solid."""
    columns = np.zeros((len(rest), len(site_list)), dtype=np.float32)
    for k, site in enumerate(site_list):
        here = np.flatnonzero(solid == site.solid)
        offset = rest[here] - site.centre
        patch = np.exp(-((offset / site.radius) ** 2).sum(1))
        phase = 2 * np.pi * (offset @ site.across) / site.wavelength + 2.0 * value_noise(rest[here], 0.06)
        columns[here, k] = site.height * patch * (np.sin(phase) + 0.25 * np.sin(2.1 * phase + 1))
    return columns


def strengths(site_list: list[Site], pose: np.ndarray) -> np.ndarray:
    """(k,) activations in [0, 1) under rotation vectors `pose` (55, 3)."""
    return np.array([site.activation(pose) for site in site_list])
