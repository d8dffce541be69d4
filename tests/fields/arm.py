"""A two-bone arm with known geometry: a tube along +x from 0 to 0.8 m, radius 0.05 m, elbow at 0.4 m."""

import math
from dataclasses import replace

import torch

from avatarrex.fields.body import BodyField, BodyFrame
from avatarrex.fields.presets import COMPACT, Preset
from avatarrex.templates.model import PosedTemplate, TemplateModel, pose_template

LENGTH, RADIUS = 0.8, 0.05
TINY = Preset(
    "tiny",
    replace(
        COMPACT.body,
        nodes=7,
        anchors=60,
        embedding=3,
        latent=2,
        decoder=(6,),
        encoder=(6,),
        geometry_local=(6,),
        geometry_feature=4,
        geometry_blend=(5,),
        patch_encoding=2,
        patch_hidden=(3,),
        patch_feature=2,
        colour_local=(6,),
        colour_feature=4,
        colour_blend=(5,),
    ),
    COMPACT.hand,
    COMPACT.face,
)


def arm_model() -> TemplateModel:
    rings, sides = 33, 12
    x = torch.linspace(0, LENGTH, rings)
    turn = torch.arange(sides) * (2 * math.pi / sides)
    tube = torch.stack(
        [x[:, None].expand(-1, sides), RADIUS * turn.cos().expand(rings, -1), RADIUS * turn.sin().expand(rings, -1)], -1
    )
    vertices = torch.cat([tube.reshape(-1, 3), torch.tensor([[0.0, 0, 0], [LENGTH, 0, 0]])])
    faces = []
    for s in range(sides):
        t = (s + 1) % sides
        for r in range(rings - 1):
            a, b, c, d = r * sides + s, r * sides + t, (r + 1) * sides + s, (r + 1) * sides + t
            faces += [[a, b, c], [b, d, c]]
        last = (rings - 1) * sides
        faces += [[len(vertices) - 2, t, s], [len(vertices) - 1, last + s, last + t]]
    lower = torch.sigmoid((vertices[:, 0] - LENGTH / 2) / 0.03)
    v = len(vertices)
    return TemplateModel(
        v_template=vertices,
        faces=torch.tensor(faces),
        shapedirs=torch.zeros(v, 3, 1),
        expression_dirs=torch.zeros(v, 3, 1),
        weights=torch.stack([1 - lower, lower], 1),
        joint_template=torch.tensor([[0.0, 0, 0], [LENGTH / 2, 0, 0]]),
        joint_shapedirs=torch.zeros(2, 3, 1),
        parents=(-1, 0),
        joint_names=("left_shoulder", "left_elbow"),
    )


def pose_arm(model: TemplateModel, elbow: tuple[float, float, float], root=(0.0, 0.0, 0.0)) -> PosedTemplate:
    dtype = model.v_template.dtype
    pose = torch.tensor([root, elbow], dtype=dtype)
    return pose_template(model, pose, torch.zeros(1, dtype=dtype), torch.zeros(1, dtype=dtype))


def rotations(seed: int = 0, angle: float = 0.4, dtype=torch.float32) -> torch.Tensor:
    from avatarrex.ops.rotation import matrix_from_rotvec

    generator = torch.Generator().manual_seed(seed)
    return matrix_from_rotvec(angle * torch.randn(21, 3, generator=generator, dtype=dtype))


def arm_field(local_frame: str = "anchors", preset: Preset = TINY, dtype=torch.float32) -> BodyField:
    torch.manual_seed(3)
    model = arm_model()
    return BodyField(model.double() if dtype == torch.float64 else model, preset, 0, local_frame).to(dtype)


def arm_frame(field: BodyField, elbow=(0.0, 0.0, 0.9), root=(0.0, 0.0, 0.0)) -> BodyFrame:
    code = field.code(rotations(dtype=field.node_rest.dtype))
    return field.frame(pose_arm(field.template, elbow, root), code)


def near(posed: PosedTemplate, count: int, spread: float = 0.02, seed: int = 1) -> torch.Tensor:
    """Points within about `spread` metres of the posed surface."""
    generator = torch.Generator().manual_seed(seed)
    vertex = torch.randint(len(posed.vertices), (count,), generator=generator)
    noise = torch.randn(count, 3, generator=generator, dtype=posed.vertices.dtype)
    return posed.vertices[vertex] + spread * noise
