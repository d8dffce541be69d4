"""Where the mesh ends: the static detail of body and face from the training pictures, as the colour that pass II starts with. Ours.

Every chosen picture is projected onto the surface that the geometry has by now (the renderer's own volume and raycast: what is
hidden is not painted), of a large one some of its pixels. A pixel counts where the body alone is drawn and the matte is opaque, by
the square of the cosine at which it is seen: towards the outline it covers more, and errors of pose and cameras shift it most.
The light E(n) is found from the part's own rig (`fields/light_fit.py`). A colour, with the light divided out, goes to the three
texels around; a texel has the weighted mean, then twice that of what is near its last mean (Geman–McClure), so that what moved
over it, a shadow or another limb, does not count. A texel never seen has the colour of the nearest seen one at rest.

Letters: p pixels, k texels around one, t texels. Root frame, metres; sRGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.errors import InputError
from avatarrex.fields.detail_texture import DetailTexture, TexelPlaces
from avatarrex.fields.face import FaceField
from avatarrex.fields.light import Irradiance
from avatarrex.fields.light_fit import LitPixels, fit_light
from avatarrex.fields.texel_neighbours import texel_neighbours
from avatarrex.parts.face import Face, face_state
from avatarrex.pointmap.point_map import PointMap
from avatarrex.pointmap.raycast import raycast
from avatarrex.shading.colour import surface_points
from avatarrex.templates.mesh import within_reach
from avatarrex.templates.model import EYES, MOUTH
from avatarrex.training.core.agreement import agreed
from avatarrex.training.core.frames import FrameStore, TrainingFrame
from avatarrex.training.core.registration import register
from avatarrex.training.core.sighting import Sighting
from avatarrex.training.core.silhouette import Silhouette
from avatarrex.training.core.supervision import hidden_at_rest
from avatarrex.training.core.trained_field import FACE

PICTURES = {"body": 360, "face": 120}
"""Projected at most, spread over frames and views; of two rigs half each. A body's surface is registered to them: with three times as
many it is nearer to the true one (docs/training.md)."""
EACH = 50_000
"""Pixels of a picture at most, drawn by chance, for registration and painting: all pictures are in memory at once, and 360 of fifty
thousand pixels are more than a dozen for each texel of 2 mm."""
FACING = 0.3
"""Cosine from which a pixel is believed."""
OPAQUE = 250 / 255
"""Matte from which a pixel has the person's colour alone."""
ALONE = 0.01
"""Share of the parts beside the body, at most."""
ROUNDS, STRAY = 2, 0.1
"""Means after the first, and the difference in sRGB at which a pixel's weight has fallen to a quarter."""

CAVITY = 0.03
"""Metres from teeth and tongue."""
SEEN = 1e-4
"""Weight from which a texel counts as seen."""


@dataclass(frozen=True)
class Projected:
    """Pixels of one picture on the texels."""

    texel: Int[Tensor, "p k"]
    weight: Float[Tensor, "p k"]
    albedo: Float[Tensor, "p 3"]


@torch.no_grad()
def start_from_pictures(
    avatar: Avatar, part: str, store: FrameStore, spacing: float, slides: bool = False, rises: bool = False
) -> None:
    """Lay texels on `body` or `face`, paint them, and let the networks begin at nothing; a body that `slides` or `rises` is registered to
    the pictures before.

    Raises `InputError` where no picture shows it.
    """
    field = avatar.face if part == "face" else avatar.body
    if isinstance(field, FaceField):
        field.add_detail(spacing, *seen_and_behind_lips(avatar))
    else:
        field.add_detail(spacing)
    assert field.detail is not None
    stores = [store] if store.close is None else [store, store.close]
    chosen = [(one, one.pairs[k]) for one in stores for k in _spread(len(one.pairs), PICTURES[part] // len(stores))]
    detail, where = field.detail, f"{store.rig.name} rig"
    sheet = field.sheets.of_texels(detail.edge) if isinstance(field, FaceField) and field.sheets else None

    def painted(sightings: Sequence[Sighting]) -> None:
        paint(detail, [project(avatar, one, part) for one in sightings], where, 0)

    if part == "body" and (slides or rises):
        register(avatar, *_seen(chosen), painted, slides, rises)
        store.renew(store.age + 1)
    seen = [lit_pixels(avatar, Picture.of(one, *pair).sighting(part), part) for one, pair in chosen]
    own = [pixels for (one, _), pixels in zip(chosen, seen) if one is store]  # another rig stands in another light
    for harmonics in avatar.light.learnt_with(part):
        harmonics.copy_(fit_light(harmonics, own, len(detail.texel)))
    light = Irradiance(avatar.light.harmonics, avatar.light.face)
    paint(detail, [_projected(one, light, part) for one in seen], where, ROUNDS, sheet)
    last = field.colour_net.mlp[-1] if isinstance(field, FaceField) else field.colour_blend[-1]
    for parameter in last.parameters():
        parameter.zero_()


def _seen(chosen: Sequence[tuple[FrameStore, tuple[int, int]]]) -> tuple[list[Sighting], list[Silhouette]]:
    """What pictures (frame and view of a store) show of the body."""
    pictures = (Picture.of(store, *pair) for store, pair in chosen)
    sightings, silhouettes = zip(*((one.sighting("body"), one.silhouette()) for one in pictures))
    return list(sightings), list(silhouettes)


def seen_and_behind_lips(avatar: Avatar) -> tuple[Bool[Tensor, " f"], Bool[Tensor, " f"]]:
    """The face's triangles that show while the mouth is closed, and those that are hidden then: teeth, tongue, and what lies within
    `CAVITY` of these, the inside of the nostrils among it.

    Lips slide over the latter, whose texels are therefore met along the gaze alone (fields/face_sheets.py): along the surface's normal
    they lay on lips, and a smile that no picture has was dotted with them.
    """
    template = avatar.person.face
    mouth = template.model.of_groups(MOUTH)
    hidden = hidden_at_rest(avatar.face, template.v_template.float()) & ~template.model.of_groups(EYES) | mouth
    cavity = hidden & within_reach(template.v_template, mouth, CAVITY)
    return ~hidden[template.faces].all(1), cavity[template.faces].all(1)


def _spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of `count` numbers, evenly."""
    numbers: list[int] = np.unique(np.linspace(0, count - 1, wanted).round().astype(int)).tolist()
    return numbers


@dataclass(frozen=True)
class Picture:
    """A training picture, and what of the avatar is at its pixels."""

    frame: TrainingFrame
    camera: Camera
    """In the root frame."""
    seen: PointMap
    colour: Float[Tensor, "h w 3"]
    matte: Float[Tensor, "h w"]

    @classmethod
    def of(cls, store: FrameStore, index: int, view: int) -> Picture:
        """Of a frame and view of the rig."""
        frame, rig = store[index], store.rig
        camera = frame.camera(rig.views[view].camera)
        colour, matte = (
            torch.from_numpy(each / np.float32(255)) for each in (rig.image(view, index), rig.matte(view, index))
        )
        return cls(frame, camera, raycast(frame.volume.sdf, camera, antialias=True), colour, matte)

    @property
    def body_alone(self) -> Bool[Tensor, "h w"]:
        """Where no part is beside the body."""
        return self.seen.part_weight.sum(-1) < ALONE

    def sighting(self, part: str) -> Sighting:
        """Its pixels of `body` or `face`, at most `EACH`."""
        seen, volume = self.seen, self.frame.volume
        eye = torch.as_tensor(self.camera.centre).to(seen.position)
        gaze = torch.nn.functional.normalize(seen.position - eye, dim=-1)
        facing = -(gaze * seen.normal).sum(-1)
        own = seen.part_weight[..., FACE] > 0 if part == "face" else self.body_alone
        counts = (seen.coverage >= 1) & own & (facing > FACING) & (self.matte >= OPAQUE)
        chosen = self._some(counts)
        parallax = -gaze[chosen] / facing[chosen][:, None]
        place, colour, weight = seen.position[chosen], self.colour[chosen], facing[chosen].square()
        posed, turn, samples = self.frame.posed, self.frame.world_from_root, volume.body_frame.samples
        return Sighting(posed, turn, samples, volume.states, place, colour, weight, parallax)

    def _some(self, counts: Bool[Tensor, "h w"]) -> tuple[Tensor, ...]:
        """Rows and columns of at most `EACH` of the pixels that count; the same each time."""
        found = torch.nonzero(counts)
        if len(found) > EACH:
            chance = torch.Generator().manual_seed(self.frame.index)
            found = found[torch.randperm(len(found), generator=chance)[:EACH].sort().values]
        return found.unbind(1)

    def silhouette(self) -> Silhouette:
        """The body's."""
        matte, samples = (self.matte > 0.5).numpy(), self.frame.volume.body_frame.samples
        return Silhouette.of(self.seen, self.body_alone, matte, self.camera, samples)


def project(avatar: Avatar, sighting: Sighting, part: str) -> Projected:
    """A picture's pixels on the texels of `body` or `face`, in the avatar's light."""
    light = Irradiance(avatar.light.harmonics, avatar.light.face)
    return _projected(lit_pixels(avatar, sighting, part), light, part)


def _projected(one: LitPixels, light: Irradiance, part: str) -> Projected:
    """With the light divided out, which is given in the frame in which it is fixed."""
    lit = light.on_face(one.normal) if part == "face" else light(one.normal)
    return Projected(one.texel, one.weight, (one.colour / lit).clamp(0, 1))


def lit_pixels(avatar: Avatar, sighting: Sighting, part: str) -> LitPixels:
    """A picture's pixels on the texels of `body` or `face`, with the normals that the light depends on."""
    places, normal = (_on_face if part == "face" else _on_body)(avatar, sighting)
    if avatar.light.frame == "world":
        normal = normal @ torch.as_tensor(sighting.world_from_root[:3, :3].T.copy()).to(normal)
    return LitPixels(places.texel, places.share * sighting.weight[:, None], sighting.colour, normal)


def _on_body(avatar: Avatar, sighting: Sighting) -> tuple[TexelPlaces, Tensor]:
    """Texels about surface points, and the unit normals of the anchors beside them, root frame."""
    assert avatar.body.detail is not None
    samples, beside = sighting.slid(avatar), sighting.beside
    rest = samples.painted_position(sighting.position, beside)
    return avatar.body.detail.places(rest), samples.facing(beside)


def _on_face(avatar: Avatar, sighting: Sighting) -> tuple[TexelPlaces, Tensor]:
    """The same of the face, with the normals of its surface."""
    face = avatar.parts["face"]
    assert isinstance(face, Face)
    root_from_face, position = sighting.posed.root_from_part("face"), sighting.position
    points = surface_points(root_from_face, position, sighting.gaze, sighting.light(avatar))
    places, normal = face.places(face_state(sighting.states), points.position, points.gaze)
    assert places is not None
    return places, normal @ points.root_from_part.T


def paint(
    detail: DetailTexture,
    pictures: list[Projected],
    where: str,
    rounds: int = ROUNDS,
    sheet: Int[Tensor, " t"] | None = None,
) -> None:
    """Means of what the pictures show, so many times reweighed; `where` they are from, for an error. Only texels of a `sheet` agree with each
    other, and unseen ones have the colour of the nearest seen one of theirs; where none of a sheet was seen, its texels stay black."""
    mean, beside = torch.zeros(len(detail.texel), 3), texel_neighbours(detail.lattice.edge, detail.lattice.faces)
    if sheet is not None:
        beside = beside[(sheet[beside[:, 0]] == sheet[beside[:, 1]]).numpy()]
    for round in range(1 + rounds):
        old = mean
        sums = torch.zeros(len(detail.texel), 4)
        for one in pictures:
            weight = one.weight
            if round:
                away = (old[one.texel] - one.albedo[:, None]).square().mean(-1)
                weight = weight / (1 + away / STRAY**2).square()
            flat = one.texel.flatten()
            counted = (weight[..., None] * one.albedo[:, None]).flatten(0, 1)
            for column, value in enumerate((weight.flatten(), *counted.T)):
                sums[:, column] += torch.bincount(flat, value, len(sums))
        total = sums[:, 0]
        if not (total > 0).any():
            raise InputError(where, "pictures", "some that show the body", "none")
        mean = detail.continued(sums[:, 1:] / total[:, None].clamp_min(1e-12), total > SEEN, sheet)
        mean = agreed(mean, total, beside)
    detail.paint(mean)
