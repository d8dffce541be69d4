"""Where limbs touch, a surface point has the colour of the limb that it is on; skin that is seen is lit from the side that is seen."""

from __future__ import annotations

from dataclasses import replace

import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.composition import WHOLE
from avatarrex.fields.light import Irradiance
from avatarrex.pipeline import render_frame
from avatarrex.settings import RenderSettings
from avatarrex.shading.colour import SurfaceColour, surface_points
from avatarrex.signals.driving import Signals
from avatarrex.signals.library import named_hand, named_pose
from avatarrex.templates.parts import PARTS
from avatarrex.templates.posed import pose_person
from avatarrex.volume.sdf_volume import sides

CROSSED = Signals.rest().replace(body_pose=named_pose("crossed_arms"))


def test_what_an_arm_touches_is_coloured_without_the_arm() -> None:
    """Of what lies beneath a hand the hand's and forearm's embeddings are NaN, of the arm the others': the frame's colours stay."""
    avatar = load_avatar()
    posed = pose_person(avatar.person, CROSSED, Counters(), None)
    aim = tuple(map(float, posed.body.joints[20]))
    frame = render_frame(avatar, CROSSED, Camera.orbit(0, 0, 0.7, 28, aim, 96, 96), RenderSettings())
    pointmap, volume = frame.pointmap, frame.volume
    seen = pointmap.hit & (pointmap.coverage == 1) & (pointmap.part_weight.sum(-1) == 0)
    position, image = pointmap.position[seen], frame.shading.unmixed[seen][:, :3]
    centre = torch.as_tensor(frame.camera.seen_from(posed.world_from_root(CROSSED)).centre, dtype=torch.float32)
    gaze = torch.nn.functional.normalize(position - centre, dim=-1)
    side = sides(volume.sdf, position)
    assert side is not None
    assert (side == WHOLE).sum() > 100
    code, found = volume.body_frame.code, []
    for limb in side[side != WHOLE].unique().tolist():
        own = avatar.ownership[PARTS[limb // 2]].own_node
        unheard = own if limb % 2 else ~own
        deaf = replace(code, embedding=torch.where(unheard[:, None], torch.nan, code.embedding))
        paint, rows = (
            SurfaceColour(avatar, posed, replace(volume.body_frame, code=deaf), {}, frame.shading.light, Counters()),
            side == limb,
        )
        with torch.no_grad():
            colour = paint.colour(position[rows], gaze[rows], torch.zeros(int(rows.sum()), 3), side[rows])
        assert colour.isfinite().all()
        torch.testing.assert_close(colour.clamp(0, 1), image[rows], atol=1e-4, rtol=0)
        found.append(int(rows.sum()))
    assert len(found) >= 3
    assert sum(found) > 500


NORMALS: list[torch.Tensor] = []


class Witness(Irradiance):
    """Remembers the normals that it was evaluated at."""

    def __call__(self, normal: torch.Tensor) -> torch.Tensor:
        NORMALS.append(normal)
        return super().__call__(normal)


def test_the_skin_of_a_fist_that_is_seen_faces_the_eye() -> None:
    """Closest to where a finger dips into the palm there may be buried skin that faces away: bright rims, seen from below."""
    avatar = load_avatar()
    fist = Signals.rest().replace(left_hand_pose=named_hand("fist", "left"))
    posed = pose_person(avatar.person, fist, Counters(), None)
    place, mesh = posed.root_from_part("left_hand"), posed.parts["left_hand"]
    aim = tuple(map(float, place[:3, :3] @ mesh.double().numpy().mean(0) + place[:3, 3]))
    frame = render_frame(avatar, fist, Camera.orbit(180, -70, 0.35, 25, aim, 128, 128), RenderSettings())
    pointmap, column = frame.pointmap, PARTS.index("left_hand")
    whole = pointmap.hit & (pointmap.part_weight[..., column] == 1)
    position, share = pointmap.position[whole], pointmap.part_weight[whole]
    centre = torch.as_tensor(frame.camera.seen_from(posed.world_from_root(fist)).centre, dtype=torch.float32)
    gaze = torch.nn.functional.normalize(position - centre, dim=-1)
    rotation = torch.as_tensor(place[:3, :3].T).float()
    local = (position - torch.as_tensor(place[:3, 3]).float()) @ rotation.T
    bare = avatar.left_hand.sdf(mesh, local).normal @ rotation
    assert ((bare * gaze).sum(-1) > 0.1).sum() > 5
    states = {name: part.state for name, part in frame.volume.parts.items()}
    light = Witness(frame.shading.light.harmonics)
    with torch.no_grad():
        SurfaceColour(avatar, posed, frame.volume.body_frame, states, light, Counters()).colour(position, gaze, share)
    normal = NORMALS.pop()
    assert not NORMALS
    assert len(normal) == len(position)
    assert (normal * gaze).sum(-1).max() < 1e-5
    torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(position)), atol=1e-5, rtol=0)


def test_networks_are_told_another_direction_and_rays_keep_theirs() -> None:
    """Of body and face: colours as seen along `told`; what is seen through a point is found along the gaze, as texels behind lips are, which
    are left out here."""
    avatar, told = load_avatar(), torch.tensor([0.6, 0.0, 0.8])
    avatar.face.sheets = None
    rest = Signals.rest()
    posed = pose_person(avatar.person, rest, Counters(), None)
    aim = tuple(map(float, posed.root_from_part("face")[:3, 3]))
    frame = render_frame(avatar, rest, Camera.orbit(20, 0, 0.8, 28, aim, 48, 48), RenderSettings())
    position, share = (each[frame.pointmap.hit] for each in (frame.pointmap.position, frame.pointmap.part_weight))
    centre = torch.as_tensor(frame.camera.seen_from(posed.world_from_root(rest)).centre, dtype=torch.float32)
    gaze = torch.nn.functional.normalize(position - centre, dim=-1)
    states = {name: part.state for name, part in frame.volume.parts.items()}
    paint = SurfaceColour(avatar, posed, frame.volume.body_frame, states, frame.shading.light, Counters())
    with torch.no_grad():
        seen, said = paint.colour(position, gaze, share), replace(paint, told=told).colour(position, gaze, share)
        torch.testing.assert_close(said, paint.colour(position, told.expand_as(gaze), share), atol=1e-6, rtol=0)
    for part in (share.sum(1) == 0, share[:, PARTS.index("face")] > 0.9):
        assert part.sum() > 20
        assert (seen - said)[part].abs().max() > 1e-3
    place = posed.root_from_part("face")
    points = surface_points(place, position, gaze, frame.shading.light, told)
    turn = torch.as_tensor(place[:3, :3].copy()).float()
    torch.testing.assert_close(points.gaze @ turn.T, gaze, atol=1e-5, rtol=0)
    torch.testing.assert_close(points.direction @ turn.T, told.expand_as(gaze), atol=1e-5, rtol=0)
    assert torch.equal(points.root_direction, told.expand_as(gaze))
