"""Both passes' losses against central differences in float64, on an avatar of a dozen nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from capture.tiny_capture import TinyCapture

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig, open_capture
from avatarrex.counters import Counters
from avatarrex.fields import presets
from avatarrex.fields.body import BodyFrame
from avatarrex.fields.presets import COMPACT
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.pointmap.raycast import raycast
from avatarrex.settings import RenderSettings
from avatarrex.templates.model import PosedTemplate
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import PosedPerson, pose_person
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.losses import weighted
from avatarrex.training.core.pass_one import BodyPass, FacePass
from avatarrex.training.core.pass_two import PatchPass
from avatarrex.training.core.pixels import PixelBatch
from avatarrex.training.core.sampling import noise_of
from avatarrex.training.core.trained_field import FACE, TrainedBody
from avatarrex.training.recipe import SMOKE, LossWeights
from avatarrex.volume.build import AvatarVolume, BuiltPart, build_volume

TINY = replace(
    COMPACT,
    name="tiny",
    body=replace(
        COMPACT.body, nodes=128, anchors=256, decoder=(8,), encoder=(8,), geometry_local=(8,), colour_local=(8,),
        patch_encoding=4, patch_hidden=(4,), colour_cutoff=0.0,
    ),
    face=replace(COMPACT.face, stem=8, geometry_levels=(4, 4), colour_levels=(4, 4), geometry_mlp=(8,), colour_mlp=(8,)),
)  # fmt: skip
STEP = 1e-6


class OneFrame(FrameStore):
    """A store of one frame as it was made."""

    def __init__(self, avatar: Avatar, rig: Rig, frame: TrainingFrame) -> None:
        self.avatar, self.rig, self.frame = avatar, rig, frame

    def __getitem__(self, index: int) -> TrainingFrame:
        return self.frame


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> tuple[Avatar, TrainingFrame, OneFrame]:
    """A tiny avatar in float64 and one posed frame of a small capture."""
    capture = open_capture(TinyCapture.make(("body",), scale=1).folder(tmp_path_factory.mktemp("tiny") / "capture"))
    presets.PRESETS["tiny"] = TINY
    try:
        avatar = Avatar.create(load_person(), "tiny", seed=3)
        avatar.light.add_face()
    finally:
        del presets.PRESETS["tiny"]
    rig = capture.rigs["body"]
    posed = pose_person(avatar.person, rig.signals[0], Counters(), None)
    volume = build_volume(avatar, posed, RenderSettings(voxel=0.03, part_voxel=0.01), Counters(), None)
    double = replace(
        posed,
        body=PosedTemplate(*(value.double() for value in vars(posed.body).values())),
        body_rotation=posed.body_rotation.double(),
        parts={name: mesh.double() for name, mesh in posed.parts.items()},
        coefficients={name: values.double() for name, values in posed.coefficients.items()},
    )
    for module in avatar.modules().values():
        module.double()
    body = replace(volume.body, frame=_double_frame(avatar, double))
    volume = replace(volume, body=body, parts=_double_parts(avatar, double, volume))
    frame = TrainingFrame(0, double, posed.world_from_root(rig.signals[0]), volume, 0)
    return avatar, frame, OneFrame(avatar, rig, frame)


def _double_frame(avatar: Avatar, posed: PosedPerson) -> BodyFrame:
    with torch.no_grad():
        return avatar.body.frame(posed.body, avatar.body.code(posed.body_rotation))


def _double_parts(avatar: Avatar, posed: PosedPerson, volume: AvatarVolume) -> dict[str, BuiltPart]:
    return {
        name: replace(built, state=avatar.parts[name].prepare(posed.parts[name], posed.coefficients[name], Counters()))
        for name, built in volume.parts.items()
    }


def pixels(camera: Camera, frame: TrainingFrame, near: np.ndarray) -> PixelBatch:
    """Pixels about root-frame points."""
    place = torch.from_numpy(frame.camera(camera).pixels(near)[0])
    generator = torch.Generator().manual_seed(0)
    colour = torch.rand(len(place), 3, generator=generator, dtype=torch.float64)
    return PixelBatch(place, colour, (torch.arange(len(place)) % 3 > 0).double())


def check(parameters: list[torch.nn.Parameter], loss, count: int, seed: int = 0) -> None:
    """Autograd against central differences along random directions in each of `count` parameters with a gradient."""
    for parameter in parameters:
        parameter.requires_grad_(True)
    found = torch.autograd.grad(loss(), parameters, allow_unused=True)
    generator = torch.Generator().manual_seed(seed)
    tested = 0
    for number, (parameter, gradient) in enumerate(zip(parameters, found)):
        if gradient is None or float(gradient.norm()) < 1e-9 or tested == count:
            continue
        direction = (
            gradient / gradient.norm()
            + 0.2 * torch.randn(gradient.shape, generator=generator) / gradient.numel() ** 0.5
        )
        direction = direction.double() / direction.norm()
        values = []
        for step in (STEP, -STEP):
            parameter.data.add_(step * direction)
            values.append(float(loss().detach()))
            parameter.data.sub_(step * direction)
        above, below = values
        slope = float((gradient * direction).sum())
        difference = (above - below) / (2 * STEP)
        assert difference == pytest.approx(slope, rel=2e-3, abs=1e-9), f"parameter {number}"
        tested += 1
    assert tested == count


def test_pass_one_of_the_body(tiny, monkeypatch):
    avatar, frame, store = tiny
    monkeypatch.setattr("avatarrex.training.core.pass_one.SHOWN", 0.0)
    # The nodes carry the eikonal points along; their places have no gradient.
    fixed = 0.3 * torch.randn(40, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    monkeypatch.setattr(TrainedBody, "around", lambda self, count, noise: fixed)
    stage = BodyPass(avatar, store, replace(SMOKE.body[0], weights=LossWeights(silhouette=2.0, node=1.0)), 0)
    stage.frame_codes = torch.nn.Parameter(stage.frame_codes.double())
    camera = store.rig.views[0].camera
    view = frame.camera(camera)
    batch = pixels(camera, frame, frame.posed.body.vertices[::900].numpy())

    def loss() -> torch.Tensor:
        noise = noise_of(0, 1, 2)
        field, terms = stage.field(frame, noise)
        rendered, _ = stage.render_losses(field, frame, view, batch, 0.02, noise)
        rendered["silhouette"], _ = stage.outline_loss(field, frame, view, batch)
        found = {name: mean.value for name, mean in rendered.items()}
        assert float(found["silhouette"].detach()) > 0
        return weighted(terms | found, stage.recipe.weights)

    modules = avatar.body
    chosen = [*modules.geometry_parameters(), *modules.colour_parameters(), stage.frame_codes]
    check(chosen, loss, 12)


def test_pass_one_of_the_face(tiny, monkeypatch):
    avatar, frame, store = tiny
    monkeypatch.setattr("avatarrex.training.core.pass_one.SHOWN", 0.0)
    monkeypatch.setattr(FacePass, "ray_weight", lambda self, share: torch.ones_like(share[:, 0]))  # without gradient
    stage = FacePass(avatar, store, replace(SMOKE.face[0], weights=LossWeights(silhouette=2.0, skin=1.0)), 0)
    camera = store.rig.views[0].camera
    view = frame.camera(camera)
    head = frame.posed.root_from_part("face")
    mesh = frame.posed.parts["face"][avatar.person.face.blend_weight > 0.9][::60].numpy()
    batch = pixels(camera, frame, mesh @ head[:3, :3].T + head[:3, 3])

    def loss() -> torch.Tensor:
        noise = noise_of(0, 1, 2)
        field, terms = stage.field(frame, noise)
        rendered, _ = stage.render_losses(field, frame, view, batch, 0.02, noise)
        rendered["silhouette"], queried = stage.outline_loss(field, frame, view, batch)
        assert queried > 5
        assert float(terms["skin"].detach()) > 0
        found = {name: mean.value for name, mean in rendered.items()}
        return weighted(terms | found, stage.recipe.weights)

    check(stage.parameters(), loss, 12)


def test_pass_two(tiny):
    avatar, frame, store = tiny
    stage = PatchPass(avatar, store, "body", SMOKE.body[1], Perceptual(None, "test"), 0)
    camera = store.rig.views[0].camera
    truth = torch.rand(camera.height, camera.width, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def loss() -> torch.Tensor:
        rendered, coverage = stage.shade(frame, camera)
        both = coverage[..., None].double()
        return weighted(stage._compare(rendered * both, truth * both, both), stage.recipe.weights)

    check(stage.parameters(), loss, 8)


@pytest.mark.parametrize("part", ["face", "body"])
def test_a_face_is_trained_as_if_no_body_shone_through_its_seam(tiny, part):
    """What the body's networks, trained later, say there now is in no colour of the face; of the body's own it is."""
    avatar, frame, store = tiny
    stage = PatchPass(avatar, store, part, getattr(SMOKE, part)[1], Perceptual(None, "test"), 0)
    head = frame.posed.root_from_part("face") @ np.array([0, 0, 0, 1.0])
    world = frame.world_from_root @ head
    camera = Camera.orbit(30, 0, 0.5, 30, tuple(world[:3]), 64, 64)
    pointmap = raycast(frame.volume.sdf, frame.camera(camera), antialias=True)
    share = pointmap.part_weight[..., FACE]
    assert ((share > 0.05) & (share < 0.95)).sum() > 20, "a seam"
    with torch.no_grad():
        image, counted = stage.shade(frame, camera)
        for parameter in avatar.body.colour_blend.parameters():
            parameter.add_(0.3)
        changed, _ = stage.shade(frame, camera)
        for parameter in avatar.body.colour_blend.parameters():
            parameter.sub_(0.3)
    wanted = pointmap.coverage if part == "body" else pointmap.coverage * (share > 0)
    torch.testing.assert_close(counted, wanted)
    assert torch.equal(image, changed) == (part == "face")
    first = FacePass(avatar, store, SMOKE.face[0], 0)
    shares = torch.tensor([[0.0, 0.0, 0.3], [0.0, 0.2, 0.0], [0.0, 0.0, 1.0]])
    assert torch.equal(first.painted(shares), torch.tensor([[0.0, 0, 1], [0, 0.2, 0], [0, 0, 1]]))


def test_each_part_learns_the_light_that_falls_on_it(tiny):
    """A face is frozen while the body is trained, and what lit it, too."""
    avatar, _, store = tiny
    test = Perceptual(None, "test")
    of_body = [BodyPass(avatar, store, SMOKE.body[0], 0), PatchPass(avatar, store, "body", SMOKE.body[1], test, 0)]
    of_face = [FacePass(avatar, store, SMOKE.face[0], 0), PatchPass(avatar, store, "face", SMOKE.face[1], test, 0)]
    for losses, own, other in (
        *((one, avatar.light.harmonics, avatar.light.face) for one in of_body),
        *((one, avatar.light.face, avatar.light.harmonics) for one in of_face),
    ):
        learnt = {id(parameter) for parameter in losses.parameters()}
        assert id(own) in learnt
        assert id(other) not in learnt
