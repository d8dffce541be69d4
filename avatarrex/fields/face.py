"""Face field: tri-planes from three renders of the posed face mesh, and two MLPs (paper sec. 3.3, eq. 11 and 12).

Geometry and colour have separate networks. Everything lives in the head frame, metres, and depends on ψ, jaw, eyes (and
shape) alone, through the renders. Letters: v vertices, p points, c channels, h w texels; planes in the order of
`orthographic.VIEW_NAMES`: front, left, right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from avatarrex.fields.detail_texture import DetailTexture, TexelPlaces
from avatarrex.fields.face_sheets import FaceSheets
from avatarrex.fields.local_networks import mlp
from avatarrex.fields.orthographic import CHANNELS, HeadBox, Impl, project, render_views
from avatarrex.fields.presets import COORDINATE_OCTAVES, DIRECTION_OCTAVES, Preset
from avatarrex.fields.unet import UNet
from avatarrex.ops.bilinear import bilinear_of_all
from avatarrex.ops.encoding import Encoding, channels, encode
from avatarrex.ops.native import serves
from avatarrex.ops.side_by_side import SideBySide
from avatarrex.templates.face import FaceTemplate

VIEW_MARGIN = 0.03
"""Metres of the views' cube around the blended face: room for an open jaw, and for the band in which s_F is used."""
COEFFICIENTS = 61
"""ψ 52, jaw 3, eyes 2 × 3."""
OUTPUT = 0.05
"""Metres per unit of the geometry MLP's output: the composition's band is about one unit deep."""

DETAIL_OFF = (0.005, 0.01)
"""Metres off its triangles where static detail fades out."""

SLOPE = 0.001
"""Half the edge, metres, of the cube over which the surface's normal is taken."""
CORNERS = torch.tensor([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Every other one of a cube: a tetrahedron."""


def surface_normal(distance: Callable[[Tensor], Tensor], position: Float[Tensor, "p 3"]) -> Float[Tensor, "p 3"]:
    """Unit normal of the surface through the points, outwards: from the distances at four corners of a small cube about each."""
    corners = CORNERS.to(position)
    around = (position + SLOPE * corners[:, None]).flatten(0, 1)
    slope = (distance(around).unflatten(0, (4, -1))[..., None] * corners[:, None]).sum(0)
    return torch.nn.functional.normalize(slope, dim=-1)


class FaceField(nn.Module):
    """The face. `geometry` and `colour_net` are two separate sets of networks."""

    def __init__(self, template: FaceTemplate, preset: Preset) -> None:
        super().__init__()
        widths = preset.face
        self.faces: Tensor
        self.albedo: Tensor
        self.box_centre: Tensor
        self.rest: Tensor
        self.own: Tensor
        box = HeadBox.around(template.v_template[template.blend_weight > 0].float(), VIEW_MARGIN)
        self.register_buffer("faces", template.faces.clone(), persistent=False)
        self.register_buffer("albedo", template.albedo.float().clone(), persistent=False)
        self.register_buffer("box_centre", box.centre, persistent=False)
        self.box_half = box.half
        direction = channels(DIRECTION_OCTAVES)
        self.driven_by_views = bool(widths.geometry_levels)
        self.geometry: _TriPlaneNet | _CoefficientNet
        self.colour_net: _TriPlaneNet | _CoefficientNet
        if self.driven_by_views:
            levels, planes, stem = widths.geometry_levels, widths.geometry_planes, widths.stem
            self.geometry = _TriPlaneNet(levels, stem, planes, widths.geometry_mlp, 1, "elu")
            levels, planes = widths.colour_levels, widths.colour_planes
            self.colour_net = _TriPlaneNet(levels, stem, planes, widths.colour_mlp, 3, "relu", extra=direction)
        else:
            self.geometry = _CoefficientNet(widths.geometry_mlp, 1, "elu")
            self.colour_net = _CoefficientNet(widths.colour_mlp, 3, "relu", extra=direction)
        self.register_buffer("rest", template.v_template.clone(), persistent=False)
        self.register_buffer("own", (template.blend_weight > 0)[template.faces].any(1), persistent=False)
        self.detail: DetailTexture | None = None
        self.sheets: FaceSheets | None = None
        self.detail_behind: Tensor | None
        """(f,) bytes, 1 for a triangle that is hidden while the mouth is closed; None in avatars of before."""
        self.register_buffer("detail_behind", None)
        module: Any = self  # its hooks are untyped in torch
        module.register_load_state_dict_pre_hook(_expect)

    @property
    def box(self) -> HeadBox:
        """The cube that the views show."""
        return HeadBox(self.box_centre, self.box_half)

    def views(self, vertices: Float[Tensor, "v 3"], impl: Impl = "auto") -> Float[Tensor, "3 7 h w"]:
        """Orthographic renders of the posed mesh (head frame)."""
        return render_views(vertices, self.faces, self.albedo, self.box, impl=impl)

    def driven(
        self, vertices: Float[Tensor, "v 3"], coefficients: Float[Tensor, " 61"], impl: Impl = "auto"
    ) -> Float[Tensor, "..."]:
        """What the planes are made of: `views` of the posed mesh or, without tri-planes, ψ, jaw and eyes themselves."""
        return self.views(vertices, impl) if self.driven_by_views else coefficients

    def geometry_planes(self, views: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """F_front, F_left, F_right (3, c, y, x) of the geometry set; three U-Net runs."""
        return self.geometry.planes(views)

    def colour_planes(self, views: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """F_front, F_left, F_right (3, c, y, x) of the colour set; three U-Net runs."""
        return self.colour_net.planes(views)

    def colour_parameters(self) -> list[nn.Parameter]:
        """Colour networks and texels."""
        modules = (self.colour_net, self.detail)
        return list(chain.from_iterable(module.parameters() for module in modules if module is not None))

    def add_detail(self, spacing: float, shown: Bool[Tensor, " f"], behind: Bool[Tensor, " f"]) -> None:
        """Lay grey texels `spacing` metres apart: on the triangles that are `shown` while the mouth is closed and where ω > 0, and on those
        that are hidden `behind` lips then."""
        self.detail_behind = behind.to(self.own.device, torch.uint8)
        laid = self.own.cpu() & shown | behind
        self._have(DetailTexture.of(self.rest.cpu(), self.faces.cpu(), spacing, laid, DETAIL_OFF))

    def expect(self, state: Mapping[str, Tensor]) -> None:
        """Have the static detail that a state to be loaded has, or none."""
        self.detail = self.sheets = self.detail_behind = None
        if "detail.edge" in state:
            if "detail_behind" in state:
                self.detail_behind = state["detail_behind"].clone()
            self._have(DetailTexture(state["detail.edge"].clone(), DETAIL_OFF).requires_grad_(False))

    def _have(self, detail: DetailTexture) -> None:
        detail.lay(self.rest.cpu(), self.faces.cpu())
        self.detail, self.sheets = detail, FaceSheets.of(detail.edge, self.detail_behind)

    def sdf(self, planes: Float[Tensor, "..."], position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """G_F, metres, at head-frame points; meaningful near the face only."""
        distance: Tensor = OUTPUT * self.geometry(planes, self.box.normalise(position))[:, 0]
        return distance

    def colour(
        self,
        planes: Float[Tensor, "..."],
        position: Float[Tensor, "p 3"],
        view: Float[Tensor, "p 3"],
        places: TexelPlaces | None = None,
    ) -> Float[Tensor, "p 3"]:
        """C_F, sRGB in [0, 1]; `view` is the unit direction from the camera to the point, head frame.

        `places`: of the points on the static detail; None: without it.
        """
        direction = encode(view, DIRECTION_OCTAVES)
        logits = self.colour_net(planes, self.box.normalise(position), direction)
        if places is not None:
            assert self.detail is not None
            logits = logits + self.detail(places)
        return torch.sigmoid(logits)


def _expect(field: FaceField, state: dict[str, Tensor], prefix: str, *rest: Any) -> None:
    field.expect({name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)})


class _TriPlaneNet(nn.Module):
    """Three U-Nets and the MLP on (γ(p), f_front, f_left, f_right[, extra])."""

    def __init__(
        self,
        levels: tuple[int, ...],
        stem: int,
        planes: int,
        hidden: tuple[int, ...],
        out: int,
        activation: str,
        extra: int = 0,
    ) -> None:
        super().__init__()
        self.unets = nn.ModuleList(UNet(CHANNELS, levels, planes, stem) for _ in range(3))
        self.mlp = mlp((channels(COORDINATE_OCTAVES) + 3 * planes + extra, *hidden, out), activation)
        self.activation = activation

    def planes(self, views: Tensor) -> Tensor:
        if not serves(views, *self.unets.parameters()):
            return torch.cat([unet(view[None]) for unet, view in zip(self.unets, views)])
        work = SideBySide()
        made = [work.add(unet, view[None]) for unet, view in zip(self.unets, views)]
        work.run()
        return torch.cat([plane.result() for plane in made])

    def forward(self, planes: Tensor, place: Tensor, extra: Tensor | None = None) -> Tensor:
        """At normalised points (p, 3)."""
        feature = bilinear_of_all(planes, project(place))
        blocks: list[Encoding | Tensor] = [Encoding(place, COORDINATE_OCTAVES), feature]
        if extra is not None:
            blocks.append(extra)
        return self.mlp.of_blocks(blocks)


class _CoefficientNet(nn.Module):
    """The ablation of the tri-planes: one MLP on (γ(p), ψ, jaw, eyes[, extra]). Its `planes` are the coefficients."""

    def __init__(self, hidden: tuple[int, ...], out: int, activation: str, extra: int = 0) -> None:
        super().__init__()
        self.mlp = mlp((channels(COORDINATE_OCTAVES) + COEFFICIENTS + extra, *hidden, out), activation)

    def planes(self, coefficients: Tensor) -> Tensor:
        return coefficients

    def forward(self, coefficients: Tensor, place: Tensor, extra: Tensor | None = None) -> Tensor:
        """At normalised points (p, 3)."""
        parts = [encode(place, COORDINATE_OCTAVES), coefficients.expand(len(place), -1)]
        output: Tensor = self.mlp(torch.cat(parts if extra is None else [*parts, extra], -1))
        return output
