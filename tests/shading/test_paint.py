"""Where limbs touch, a surface point has the colour of the limb that it is on."""

from __future__ import annotations

from dataclasses import replace

import torch

from avatarrex.avatar import load_avatar
from avatarrex.camera import Camera
from avatarrex.counters import Counters
from avatarrex.fields.composition import WHOLE
from avatarrex.pipeline import RenderSettings, render_frame
from avatarrex.shading.paint import Paint
from avatarrex.signals.library import named_pose
from avatarrex.signals.signals import Signals
from avatarrex.templates.posed import pose_person
from avatarrex.volume.volume import PARTS, sides

CROSSED = Signals.rest().replace(body_pose=named_pose("crossed_arms"))


def test_what_an_arm_touches_does_not_hear_the_arm() -> None:
    """Of what lies beneath a hand the hand's and forearm's embeddings are NaN, of the arm the others': the frame's colours stay."""
    avatar = load_avatar()
    posed = pose_person(avatar.person, CROSSED, Counters(), None)
    aim = tuple(map(float, posed.body.joints[20]))
    frame = render_frame(avatar, CROSSED, Camera.orbit(0, 0, 0.7, 28, aim, 96, 96), RenderSettings())
    pointmap, volume = frame.pointmap, frame.volume
    seen = pointmap.hit & (pointmap.coverage == 1) & (pointmap.part_weight.sum(-1) == 0)
    position, image = pointmap.position[seen], frame.image[seen][:, :3]
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
        paint, rows = Paint(avatar, posed, replace(volume.body_frame, code=deaf), None, Counters()), side == limb
        with torch.no_grad():
            colour = paint.colour(position[rows], gaze[rows], torch.zeros(int(rows.sum()), 3), side[rows])
        assert colour.isfinite().all()
        torch.testing.assert_close(colour.clamp(0, 1), image[rows], atol=1e-4, rtol=0)
        found.append(int(rows.sum()))
    assert len(found) >= 3
    assert sum(found) > 500
