"""Fits the body poses that touch: joint angles for which named points of the default person's skin meet, in degrees.

    python tools/fit_poses.py [kneel think …]

writes their entries in `avatarrex/data/fitted_poses.json`. A goal is a weighted residual in metres: a point that meets another, a bone's
direction, a height. Added are penetration of an arm into the rest of the body (with `CLOTH` between), the joint limits, and the
distance from where the fit starts. Points are given at rest, left side; `right:` mirrors one. Root frame, metres.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from avatarrex.files.assets import DATA
from avatarrex.files.gate import write_text
from avatarrex.files.json_text import read_json
from avatarrex.ops.skinning import blend
from avatarrex.signals.joints import JOINT_NAMES
from avatarrex.signals.library import HANDS
from avatarrex.signals.limits import LIMITS
from avatarrex.templates.model import TemplateModel, pose_template
from avatarrex.templates.person import load_person

CLOTH = 0.008
"""Metres that an arm stays off the skin of the rest: shirt and trousers of the packaged subject."""
MIRROR = torch.tensor([1.0, -1.0, -1.0])
EVERY = 3
"""Every third vertex of the skin: they lie 1 cm apart."""
ROWS = {name: row for row, name in enumerate(JOINT_NAMES)}
FITTED = DATA / "fitted_poses.json"
Turn = tuple[float, float, float]


def thinned() -> tuple[TemplateModel, Tensor]:
    """The default person's skin with a third of its vertices, and its rest normals."""
    body = load_person().body
    rows = body.groups["body"][::EVERY]
    names = ("v_template", "shapedirs", "expression_dirs", "weights", "posedirs")
    kept = {name: getattr(body, name)[rows] for name in names}
    return replace(body, **kept, faces=body.faces[:0], groups={}), body.normals[rows]


BODY, NORMALS = thinned()
OWNER = BODY.weights.argmax(1).numpy()
REST = BODY.v_template.numpy()


def vertices(side: str, *parts: str) -> np.ndarray:
    """Indices of the vertices that move most with `side`'s joints whose names begin with one of `parts`."""
    rows = [ROWS[name] for name in JOINT_NAMES if name.startswith(tuple(f"{side}_{part}" for part in parts))]
    return np.flatnonzero(np.isin(OWNER, rows))


ARM = ("elbow", "wrist", "index", "middle", "ring", "pinky", "thumb")
BARE = ("head", "jaw", "neck", "left_elbow", "right_elbow", "left_wrist", "right_wrist", *JOINT_NAMES[25:])
MARGIN = torch.tensor(np.where(np.isin(OWNER, [ROWS[name] for name in BARE]), 0.0, CLOTH), dtype=torch.float32)
ARMS = {side: vertices(side, *ARM) for side in ("left", "right")}


def at(side: str, point: Turn) -> int:
    """The vertex nearest a rest point; mirrored for the right side."""
    place = np.array(point) * ((-1, 1, 1) if side == "right" else (1, 1, 1))
    return int(np.linalg.norm(REST - place, axis=1).argmin())


@dataclass
class Posed:
    """What goals look at."""

    vertices: Tensor
    normals: Tensor
    joints: Tensor
    transforms: Tensor

    def joint(self, name: str) -> Tensor:
        """Its place."""
        return self.joints[ROWS[name]]

    def bone(self, start: str, end: str) -> Tensor:
        """Unit direction."""
        return torch.nn.functional.normalize(self.joint(end) - self.joint(start), dim=0)

    def axis(self, joint: str, direction: Turn) -> Tensor:
        """A rest direction turned by the joint."""
        return self.transforms[ROWS[joint], :3, :3] @ torch.tensor(direction)


Goal = Callable[[Posed], Tensor]


@dataclass
class Fit:
    """A pose to be found: where it starts (degrees), which joints are free, what it must meet."""

    start: dict[str, Turn]
    free: tuple[str, ...]
    goals: list[Goal]
    fixed: dict[str, Turn] = field(default_factory=dict)
    """Joints of hands that stay as they are."""
    symmetric: bool = False
    """Whether the right side mirrors the left, which alone is free."""
    push: float = 0.6
    """Weight of penetration."""
    stay: float = 0.004
    """Weight of the distance from the start, metres a radian."""


def touch(one: int, other: int, gap: float = 0.0, weight: float = 1.0) -> Goal:
    """Vertex `one` lies `gap` over vertex `other`."""
    return lambda posed: weight * (posed.vertices[one] - posed.vertices[other] - gap * posed.normals[other])


def aim(start: str, end: str, direction: Turn, weight: float = 0.02) -> Goal:
    """A bone points in a direction."""
    wanted = torch.nn.functional.normalize(torch.tensor(direction), dim=0)
    return lambda posed: weight * (posed.bone(start, end) - wanted)


def face(joint: str, rest: Turn, direction: Turn, weight: float = 0.02) -> Goal:
    """A rest direction of a joint's frame (a palm's normal) points in a direction."""
    wanted = torch.nn.functional.normalize(torch.tensor(direction), dim=0)
    return lambda posed: weight * (posed.axis(joint, rest) - wanted)


def place(joint: str, target: Turn, weight: float = 0.2) -> Goal:
    """A joint is somewhere."""
    return lambda posed: weight * (posed.joint(joint) - torch.tensor(target))


def solved(fit: Fit, steps: int = 400) -> tuple[dict[str, Turn], float, float]:
    """Degrees of the joints, the goals' residual and the deepest penetration, metres."""
    pose = torch.zeros(55, 3)
    for name, turn in {**fit.fixed, **fit.start}.items():
        for row, values in _sides(name, turn):
            pose[row] = torch.tensor(np.radians(values), dtype=torch.float32)
    rows = [ROWS[name] for name in fit.free]
    other = [ROWS[name.replace("left_", "right_")] for name in fit.free]
    start, bounds = pose[rows].clone(), torch.tensor(LIMITS[rows], dtype=torch.float32)
    value = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([value], lr=0.03)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, 0.001)
    near: list[tuple[np.ndarray, np.ndarray]] = []
    for step in range(steps):
        whole = pose.clone()
        whole[rows] = torch.minimum(torch.maximum(value, bounds[..., 0]), bounds[..., 1])
        if fit.symmetric:
            whole[other] = whole[rows] * MIRROR
        model = pose_template(BODY, whole, torch.zeros(10), torch.zeros(52))
        linear = blend(model.skinning, BODY.weights)[:, :, :3]
        normals = (linear @ NORMALS[:, :, None])[:, :, 0]
        posed = Posed(model.vertices, normals, model.joints, model.joint_transforms)
        if step % 10 == 0:
            near = neighbours(posed.vertices.detach().numpy())
        loss = sum((goal(posed) ** 2).sum() for goal in fit.goals)
        loss = loss + fit.stay**2 * ((value - start) ** 2).sum() + 0.02 * ((value - whole[rows]) ** 2).sum()
        deepest = 0.0
        for one, near_one in near:
            depth = -((posed.vertices[one] - posed.vertices[near_one]) * posed.normals[near_one].detach()).sum(-1)
            loss = loss + fit.push * (torch.relu(depth + MARGIN[near_one]) ** 2).sum()
            deepest = max(deepest, float(depth.detach().max()) if len(depth) else 0.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    goals = float(sum((goal(posed) ** 2).sum() for goal in fit.goals).detach()) ** 0.5
    turns = {}
    for name, row in ROWS.items():
        if whole[row].any():
            turns[name] = tuple(round(float(angle), 1) + 0.0 for angle in np.degrees(whole[row].detach().numpy()))
    return turns, goals, deepest


def neighbours(points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each arm the vertices within 4 cm of the rest of the body (the other arm included), and the nearest of those."""
    pairs = []
    for side in ("left", "right"):
        mine = ARMS[side]
        others = np.setdiff1d(np.arange(len(points)), np.concatenate([mine, vertices(side, "shoulder", "collar")]))
        distance, nearest = cKDTree(points[others]).query(points[mine])
        close = distance < 0.04
        pairs.append((mine[close], others[nearest[close]]))
    return pairs


def _sides(name: str, turn: Turn) -> list[tuple[int, np.ndarray]]:
    if not name.startswith("both_"):
        return [(ROWS[name], np.array(turn))]
    joint = name.removeprefix("both_")
    return [(ROWS[f"left_{joint}"], np.array(turn)), (ROWS[f"right_{joint}"], np.array(turn) * (1, -1, -1))]


def hand(name: str, *sides: str) -> dict[str, Turn]:
    """A hand pose of the library as joints of a body."""
    mirrored = {"left": (1, 1, 1), "right": (1, -1, -1)}
    return {
        f"{side}_{joint}": tuple(np.multiply(turn, mirrored[side]).tolist())
        for side in sides
        for joint, turn in HANDS[name].items()
    }


def arm(*sides: str) -> tuple[str, ...]:
    """The joints of an arm."""
    return tuple(f"{side}_{joint}" for side in sides for joint in ("collar", "shoulder", "elbow", "wrist"))


LEFT_PALM = at("left", (0.775, 0.42, 0.0))
RIGHT_PALM = at("right", (0.775, 0.42, 0.0))
DOWN = (0.0, -1.0, 0.0)
"""A palm's normal at rest."""
CHIN = int(np.where((np.abs(REST[:, 0]) < 0.02) & (ROWS["jaw"] == OWNER), REST[:, 2] - REST[:, 1], -9).argmax())
DOWN_ARMS: dict[str, Turn] = {"both_shoulder": (0, 0, -72), "both_elbow": (0, -12, 0)}


def mirrored(*goals: Callable[[str, Callable[[Turn], Turn]], Goal]) -> list[Goal]:
    """Goals for both sides; each gets the side and what mirrors a direction."""
    return [
        goal(side, (lambda d: d) if side == "left" else (lambda d: (-d[0], d[1], d[2])))
        for goal in goals
        for side in ("left", "right")
    ]


def palm(side: str) -> int:
    """The middle of a palm."""
    return LEFT_PALM if side == "left" else RIGHT_PALM


def interlaced(order: tuple[str, ...] = ("index", "middle", "ring", "pinky")) -> list[Goal]:
    """Each finger's first bone crosses between two of the other hand's: right index, left index, right middle, …"""

    def middle(posed: Posed, side: str, finger: str) -> Tensor:
        return 0.45 * posed.joint(f"{side}_{finger}1") + 0.55 * posed.joint(f"{side}_{finger}2")

    def goal(posed: Posed) -> Tensor:
        right, left = (torch.stack([middle(posed, side, finger) for finger in order]) for side in ("right", "left"))
        return torch.cat([left[:3] - (right[:3] + right[1:]) / 2, right[1:] - (left[:3] + left[1:]) / 2])

    return [goal]


def lowest(*names: str) -> Tensor:
    """Vertices of joints, to be lowered onto the floor."""
    return torch.tensor(np.flatnonzero(np.isin(OWNER, [ROWS[name] for name in names])))


def on_floor(*names: str, floor: Callable[[Posed], Tensor]) -> Goal:
    """The lowest point of some joints' skin is on the floor."""
    rows = lowest(*names)
    return lambda posed: (posed.vertices[rows, 1].min() - floor(posed)).view(1)


def sole(side: str) -> tuple[int, int]:
    """Heel and ball."""
    return at(side, (0.167, -0.95, -0.09)), at(side, (0.164, -0.95, 0.13))


def standing_on(side: str) -> Callable[[Posed], Tensor]:
    """The floor's height: the mean of heel and ball of a foot."""
    heel, ball = sole(side)
    return lambda posed: (posed.vertices[heel, 1] + posed.vertices[ball, 1]) / 2


def level(side: str) -> Goal:
    """A sole that is parallel to the floor."""
    heel, ball = sole(side)
    return lambda posed: (posed.vertices[heel, 1] - posed.vertices[ball, 1]).view(1)


def tip(side: str, finger: str) -> int:
    """The pad of a finger: of its last bone's skin the vertex furthest out and down at rest."""
    mine = np.flatnonzero(ROWS[f"{side}_{finger}3"] == OWNER)
    return int(mine[(np.abs(REST[mine, 0]) - 0.7 * REST[mine, 1]).argmax()])


FINGERS_1 = tuple(f"{side}_{finger}1" for side in ("left", "right") for finger in ("index", "middle", "ring", "pinky"))
FITS: dict[str, Callable[[], Fit]] = {
    "hands_on_hips": lambda: Fit(
        {"both_shoulder": (30, 20, -50), "both_elbow": (-10, -100, 0)},
        arm("left"),
        mirrored(
            lambda s, m: touch(palm(s), at(s, (0.17, 0.075, 0.01)), 0.010, 2.5),
            lambda s, m: aim(f"{s}_wrist", f"{s}_middle1", m((-0.25, -0.5, 0.8)), 0.025),
            lambda s, m: place(f"{s}_elbow", m((0.43, 0.27, -0.04)), 0.28),
        ),
        hand("relaxed", "left", "right"),
        symmetric=True,
    ),
    "crossed_arms": lambda: Fit(
        {"left_collar": (-3, -12, 7), "left_shoulder": (22, -57, -71), "left_elbow": (-7, -98, -8), "left_wrist": (-10, -5, -16),
         "right_collar": (0, 12, 0), "right_shoulder": (20, 51, 65), "right_elbow": (-3, 104, 8), "right_wrist": (-10, 0, 12)},
        (*arm("left", "right"), *(f"{side}_thumb{k}" for side in ("left", "right") for k in (1, 2, 3))),
        [
            touch(RIGHT_PALM, at("left", (0.39, 0.46, 0.06)), 0.010, 0.9),
            touch(LEFT_PALM, at("right", (0.39, 0.43, 0.04)), 0.012, 0.4),
            aim("right_elbow", "right_wrist", (1, 0.04, 0.14), 0.03),
            aim("left_elbow", "left_wrist", (-1, 0.0, 0.05), 0.03),
            place("left_elbow", (0.26, 0.23, 0.07), 0.1),
            place("right_elbow", (-0.26, 0.24, 0.07), 0.1),
        ],
        hand("relaxed", "left", "right"),
        push=4.0,
    ),
    "think": lambda: Fit(
        {"left_shoulder": (30, -45, -65), "left_elbow": (-40, -90, 0), "right_shoulder": (-10, 50, 70), "right_elbow": (-20, 130, 0)},
        (*arm("left", "right"), *(f"right_{finger}{k}" for finger in ("index", "thumb") for k in (1, 2, 3))),
        [
            touch(tip("right", "index"), at("left", (-0.014, 0.625, 0.145)), 0.002),
            touch(tip("right", "thumb"), at("left", (0.016, 0.618, 0.138)), 0.002),
            place("right_elbow", (-0.17, 0.22, 0.13), 0.2),
            face("right_wrist", DOWN, (0.3, 0.1, -0.9), 0.02),
            touch(LEFT_PALM, at("right", (0.43, 0.44, -0.03)), 0.008, 0.7),
            place("left_elbow", (0.25, 0.22, 0.07), 0.15),
            aim("left_elbow", "left_wrist", (-1, -0.05, 0.35), 0.03),
        ],
        {**hand("relaxed", "left"), **hand("loose_fist", "right"), "head": (6, 0, -3)},
    ),
    "clasped_hands": lambda: Fit(
        {"both_shoulder": (34, -40, -60), "both_elbow": (-40, -75, 0), **{name: (0, 0, -40 if "left" in name else 40) for name in FINGERS_1}},
        (*arm("left", "right"), *FINGERS_1),
        [
            *interlaced(),
            *mirrored(
                lambda s, m: place(f"{s}_middle1", m((0.028, 0.10, 0.26)), 0.3),
                lambda s, m: place(f"{s}_elbow", m((0.30, 0.21, 0.0)), 0.2),
                lambda s, m: aim(f"{s}_wrist", f"{s}_middle1", m((-0.55, -0.25, 0.8)), 0.03),
                lambda s, m: face(f"{s}_wrist", DOWN, m((-0.8, 0.0, -0.6)), 0.03),
            ),
        ],
        {name: turn for name, turn in hand("clasp", "left", "right").items() if name not in FINGERS_1},
    ),
    "salute": lambda: Fit(
        {"right_shoulder": (-39, 16, -4), "right_elbow": (-35, 134, 3)},
        arm("right"),
        [
            touch(tip("right", "index"), at("right", (0.052, 0.745, 0.105)), 0.006),
            aim("right_wrist", "right_middle1", (0.75, 0.65, 0.05), 0.03),
            face("right_wrist", DOWN, (0.1, -0.6, 0.8), 0.02),
            place("right_elbow", (-0.43, 0.47, 0.08), 0.15),
        ],
        {"left_shoulder": (0, 0, -72), "left_elbow": (0, -12, 0)},
    ),
    "hand_on_heart": lambda: Fit(
        {"right_shoulder": (20, 50, 60), "right_elbow": (-20, 110, 0)},
        arm("right"),
        [
            touch(RIGHT_PALM, at("left", (0.05, 0.36, 0.14)), 0.014),
            touch(tip("right", "middle"), at("left", (0.13, 0.40, 0.12)), 0.014, 0.5),
            place("right_elbow", (-0.29, 0.24, 0.07), 0.15),
        ],
        {"left_shoulder": (0, 0, -72), "left_elbow": (0, -12, 0), **hand("relaxed", "left"), "head": (4, 0, 0)},
    ),
    "facepalm": lambda: Fit(
        {"right_shoulder": (-10, 60, 50), "right_elbow": (-20, 135, 0), "head": (18, 0, 0), "neck": (8, 0, 0)},
        (*arm("right"), *(f"right_{finger}{k}" for finger in ("index", "middle") for k in (1, 2))),
        [
            touch(tip("right", "middle"), at("left", (-0.01, 0.78, 0.13)), 0.004),
            touch(tip("right", "index"), at("left", (0.02, 0.78, 0.13)), 0.004),
            touch(RIGHT_PALM, at("right", (0.035, 0.69, 0.13)), 0.012, 0.5),
            place("right_elbow", (-0.22, 0.31, 0.22), 0.15),
        ],
        {"left_shoulder": (0, 0, -72), "left_elbow": (0, -12, 0), **hand("relaxed", "left", "right")},
    ),
    "kneel": lambda: Fit(
        {"left_hip": (-98, 6, 4), "left_knee": (98, 0, 0), "right_hip": (0, -4, -2), "right_knee": (92, 0, 0),
         "left_ankle": (0, 0, 0), "right_ankle": (-10, 0, 0), "right_foot": (-30, 0, 0)},
        ("left_hip", "left_knee", "left_ankle", "right_hip", "right_knee", "right_ankle", "right_foot"),
        [
            level("left"),
            on_floor("right_knee", "right_hip", floor=standing_on("left")),
            on_floor("right_ankle", "right_foot", floor=standing_on("left")),
            lambda posed: 0.2 * (posed.joint("left_knee")[2:] - posed.joint("left_ankle")[2:] - 0.03),
        ],
        {"both_shoulder": (0, -15, -68), "both_elbow": (0, -35, 0)},
    ),
}  # fmt: skip


def main() -> None:
    """Fit and print."""
    for name in sys.argv[1:] or FITS:
        turns, goals, deepest = solved(FITS[name]())
        entries = {**(read_json(FITTED) if FITTED.exists() else {}), name: turns}
        lines = (f"{json.dumps(key)}: {json.dumps(entries[key])}" for key in FITS if key in entries)
        write_text(FITTED, "{\n" + ",\n".join(lines) + "\n}\n")
        print(f"{name}: goals {1000 * goals:.1f} mm, deepest {1000 * deepest:.1f} mm", flush=True)


if __name__ == "__main__":
    main()
