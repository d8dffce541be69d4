"""The body field 𝒜_B (paper sec. 3.1, eq. 3–9): N local networks around N nodes, blended by influence.

    p_i = T⁻¹p − (n̄_i + Δn_i)
    𝒢_B(p) = 𝒢_blend( Σ w_i 𝒢_i(p_i, e_i) / Σ w_i )              signed distance, metres, negative inside
    𝒞_B(p) = 𝒞_blend( Σ w_i 𝒞_i(p_i, e_i, f_i) / Σ w_i, v )       f_i = Bilinear(F_i, Π_i p_i); sRGB in [0, 1], times E(n): light.py

`frame` gathers all that depends on the pose; points come afterwards and may be any. Points live in the root frame
(global orientation and translation removed), which is also the pelvis frame of the view direction.

Letters: n nodes, p points, k (point, node) pairs sorted by node, e embedding, c channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from avatarrex.errors import InputError
from avatarrex.fields import loops
from avatarrex.fields.code import BodyCode, DetailCode
from avatarrex.fields.detail_texture import DetailTexture
from avatarrex.fields.influence import EPSILON, GATE, RADIUS, SIGMA, Pairs, find_pairs, gate, influence, weighted_mean
from avatarrex.fields.light import Irradiance
from avatarrex.fields.local_frame import (
    ANCHOR_SIGMA,
    LOCAL_FRAMES,
    Samples,
    take,
)
from avatarrex.fields.local_networks import LocalNetworks, mlp
from avatarrex.fields.nodes import anchors, covering_radius, node_normals, part_labels, plane_axes
from avatarrex.fields.outgrowth import Outgrowth
from avatarrex.fields.patches import NoPatches, PatchNetwork, patch_features
from avatarrex.fields.presets import COORDINATE_OCTAVES, DIRECTION_OCTAVES, Preset
from avatarrex.fields.slide import Slide
from avatarrex.fields.texel_mesh import texel_height, texel_mesh
from avatarrex.ops import native
from avatarrex.ops.encoding import Encoding, channels
from avatarrex.ops.farthest_points import farthest_points
from avatarrex.ops.skinning import blend, blend_rotations, invert_affine, skin
from avatarrex.templates.mesh import vertex_normals
from avatarrex.templates.model import PosedTemplate, TemplateModel

SDF_UNIT = 0.05
"""Metres per unit of the blending MLP's output: distances near the surface become O(1)."""
COLOUR_UNIT = RADIUS / 2
"""Metres per unit of the colour networks' coordinates."""
CLOTH = 0.02
"""How far the surface may stand off the template when the empty space is filled, metres."""
MAX_CLOTHING_OFFSET = 0.04
"""Metres: cloth and hair that stand off farther are not measured."""
APART = 10.0
"""Metres by which the gate between limbs takes an outgrowth's anchors to be shifted (`Samples.gate_rest`)."""
VISIBLE = 16.0
"""sRGB per metre: a change of colour by 4/255 counts as much as a millimetre."""
LEAST_FILL = 0.005
"""Smallest fill, metres: a pose that stretches the nodes apart must not put a surface into empty space."""


@dataclass(frozen=True)
class BodyFrame:
    """The body field at one pose: everything that does not depend on the point."""

    code: BodyCode
    node_position: Float[Tensor, "n 3"]
    """n_i = T_i(n̄_i + Δn_i), root frame."""
    node_rest: Float[Tensor, "n 3"]
    """n̄_i + Δn_i."""
    node_from_rest: Float[Tensor, "n 3 4"]
    samples: Samples
    """Anchors of the local frame."""
    cover: Float[Tensor, ""]
    """No point of the surface is farther from its nearest node, metres."""
    among: Bool[Tensor, " n"] | None = None
    """The nodes that the field is restricted to; None: all."""

    def restricted(self, nodes: Bool[Tensor, " n"] | None) -> BodyFrame:
        """The field of some nodes and the anchors they own; None: as it is."""
        return self if nodes is None else replace(self, samples=self.samples.among(nodes), among=nodes)


class BodyField(nn.Module):
    """Nodes, networks and the pose decoder of the body.

    Args:
        model: the body template the nodes are placed on.
        preset: widths.
        seed: of the farthest point sampling (network weights follow torch's own seed).
        local_frame: one of `LOCAL_FRAMES`.
        replaced: (v,) bool, vertices whose place another part takes wholly; no sample carries a frame there, or what such
            a part touches would map to rest positions in flesh that is never seen.
    """

    replaced: Tensor
    node_vertex: Tensor
    anchor_vertex: Tensor
    node_rest: Tensor
    node_axes: Tensor
    node_weights: Tensor
    node_part: Tensor
    sample_vertex: Tensor
    """(s,) of each anchor of the skin, as `sample_anchor`; the other `sample_*` have those of an outgrowth after them (a = s + o)."""
    sample_rest: Tensor
    sample_weights: Tensor
    sample_owner: Tensor
    sample_normal: Tensor
    sample_anchor: Tensor
    sample_gate_rest: Tensor
    """(a, 3) rest positions, those of an outgrowth shifted by `APART` (`Samples.gate_rest`)."""
    relief: Tensor | None
    """Metres that the surface stands off where the networks have it along the normal at rest, of each anchor, in every pose."""
    detail_height: Tensor | None
    """(v,) metres that the static detail lies above the template (texel_mesh.py); None of texels that lie on the skin."""
    clothing_offset: Tensor
    """(v,) metres that the surface stands off each template vertex at rest (`measure_clothing_offset`); zero until measured."""

    def __init__(
        self,
        model: TemplateModel,
        preset: Preset,
        seed: int = 0,
        local_frame: str = "turned",
        replaced: Bool[Tensor, " v"] | None = None,
    ) -> None:
        super().__init__()
        if local_frame not in LOCAL_FRAMES:
            raise InputError("body field", "local_frame", " or ".join(LOCAL_FRAMES), local_frame)
        widths = preset.body
        self.widths, self.local_frame, self.template = widths, local_frame, model
        self.slide: Slide | None = None
        self.outgrowth: Outgrowth | None = None
        self.register_buffer("relief", None)
        self.register_buffer("detail_height", None)
        self.register_buffer("node_vertex", farthest_points(model.v_template, widths.nodes, seed))
        self.register_buffer("anchor_vertex", anchors(model, widths.anchors, seed))
        self.register_buffer("clothing_offset", torch.zeros(len(model.v_template)))
        nothing = torch.zeros(len(model.v_template), dtype=torch.bool)
        self.register_buffer("replaced", nothing if replaced is None else replaced, persistent=False)
        module: nn.Module = self
        module.register_state_dict_post_hook(_file_names)
        module.register_load_state_dict_pre_hook(_own_names)
        module.register_load_state_dict_post_hook(lambda module, _: module.place())
        self.place()
        n, e = len(self.node_vertex), widths.embedding
        coordinate, direction = channels(COORDINATE_OCTAVES), channels(DIRECTION_OCTAVES)
        self.code_network = DetailCode(n, e, widths.latent, widths.decoder, widths.encoder)
        shared = widths.colour_feature if widths.colour_local is None else 0
        out = widths.geometry_feature + shared
        self.geometry_local = LocalNetworks(n, coordinate, e, widths.geometry_local, out, "elu")
        self.geometry_blend = mlp((widths.geometry_feature, *widths.geometry_blend, 1), "elu")
        patch = widths.patch_feature
        self.patch_network: PatchNetwork | NoPatches = (
            PatchNetwork(n, e, widths.patch_encoding, widths.patch_hidden, patch) if patch else NoPatches()
        )
        self.colour_local = (
            None
            if widths.colour_local is None
            else LocalNetworks(n, coordinate + patch, e, widths.colour_local, widths.colour_feature, "relu")
        )
        self.colour_blend = mlp((widths.colour_feature + direction, *widths.colour_blend, 3), "relu")
        self.detail: DetailTexture | None = None

    def place(self) -> None:
        """Derive rest positions, normals and weights of nodes and anchors (after these were chosen or loaded)."""
        model, vertex = self.template, self.node_vertex.cpu()
        like = self.clothing_offset
        normal = node_normals(model, vertex)
        sampled = self.anchor_vertex.cpu()
        kept = torch.nonzero(~self.replaced.cpu()[sampled])[:, 0]
        sampled = sampled[kept]
        rest = model.v_template
        of_skin = rest[sampled], model.normals[sampled], model.weights[sampled]
        anchor, outward, weights = (torch.cat(each) for each in zip(of_skin, *self._hung_anchors()))
        gate_rest = anchor.clone()
        gate_rest[len(sampled) :, 0] += APART
        derived = {
            "node_rest": rest[vertex],
            "node_axes": plane_axes(normal),
            "node_weights": model.weights[vertex],
            "sample_rest": anchor,
            "sample_normal": outward,
            "sample_weights": weights,
            "sample_gate_rest": gate_rest,
        }
        for name, value in derived.items():
            self.register_buffer(name, value.to(like), persistent=False)
        self.register_buffer("sample_vertex", sampled.to(like.device), persistent=False)
        self.register_buffer("sample_anchor", kept.to(like.device), persistent=False)
        owner = torch.cdist(anchor, rest[vertex]).argmin(1)
        self.register_buffer("sample_owner", owner.to(like.device), persistent=False)
        labels = part_labels(model.joint_names, model.weights[vertex])
        self.register_buffer("node_part", labels.to(like.device), persistent=False)
        self._lay_slide()

    def _hung_anchors(self) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Of an outgrowth that hangs on a joint, after those of the skin: places and outward directions at rest, skinning weights."""
        own, like = self.outgrowth, self.template.v_template
        if own is None or own.joint is None or own.anchor is None:
            return []
        anchor = own.anchor.double()
        weights = self.template.weights.new_zeros(len(anchor), self.template.weights.shape[1])
        weights[:, int(own.joint)] = 1
        return [(anchor.to(like), torch.from_numpy(own.outward(anchor.numpy())).to(like), weights)]

    def set_outgrowth(self, outgrowth: Outgrowth | None) -> None:
        """Have one, or none."""
        self.outgrowth = outgrowth
        if outgrowth is not None:
            outgrowth.lay(self.template.v_template)
        self.place()

    @torch.no_grad()
    def measure_clothing_offset(self, posed: PosedTemplate, code: BodyCode) -> None:
        """Set `clothing_offset` from the field under the rest pose: the depth of each template vertex below the surface.

        Samples are then searched where the surface is: cloth beside an arm must not take the arm's skin for its own.
        """
        self.clothing_offset.zero_()
        depth = self.sdf(self.frame(posed, code), self.template.v_template.to(self.clothing_offset))
        self.clothing_offset.copy_((-depth).clamp(-MAX_CLOTHING_OFFSET, MAX_CLOTHING_OFFSET))

    @torch.no_grad()
    def embedding_effect(self, posed: PosedTemplate, code: BodyCode) -> float:
        """Metres that a unit change of all embeddings counts, in the mean over the surface.

        The larger of what it moves the surface and what it changes the colour, in metres by `VISIBLE`.
        """
        frame, step = self.frame(posed, code), 0.05
        noise = torch.rand(code.embedding.shape, generator=torch.Generator().manual_seed(0)).round() * 2 - 1
        other = replace(frame, code=replace(code, embedding=code.embedding + step * noise.to(code.embedding)))
        outward = vertex_normals(posed.vertices, self.template.faces)
        points = (posed.vertices + outward * self.clothing_offset[:, None])[::8].to(code.embedding)
        inward = -outward[::8].to(points)
        moved = (self.sdf(other, points) - self.sdf(frame, points)).abs().mean()
        tinted = (self.colour(other, None, points, inward) - self.colour(frame, None, points, inward)).abs().mean()
        return float(moved.maximum(tinted / VISIBLE)) / step

    def geometry_parameters(self) -> list[nn.Parameter]:
        """What pass I trains and pass II freezes: decoder, encoder, geometry networks."""
        modules = (self.code_network, self.geometry_local, self.geometry_blend)
        return list(chain.from_iterable(module.parameters() for module in modules))

    def colour_parameters(self) -> list[nn.Parameter]:
        """Patches and colour networks; what is shared with the geometry is the geometry's."""
        modules = (self.patch_network, self.colour_local, self.colour_blend, self.detail)
        return list(chain.from_iterable(module.parameters() for module in modules if module is not None))

    def add_detail(self, spacing: float) -> None:
        """Lay grey texels where the clothes are, `spacing` metres apart, but where another part takes the skin's place."""
        template = self.template
        shown = ~self.replaced.cpu()[template.faces].all(1)
        self.detail_height = texel_height(template, self._thickness().cpu()).to(self.clothing_offset)
        self.detail = DetailTexture.of(self._texel_mesh(), template.faces, spacing, shown)

    def _thickness(self) -> Float[Tensor, " v"]:
        """Of the clothes, metres: `clothing_offset` without the relief, which rest positions do not contain."""
        if self.relief is None:
            return self.clothing_offset
        of_skin = self.sample_rest[: len(self.sample_anchor)]
        nearest = torch.cdist(self.template.v_template.to(of_skin), of_skin).argmin(1)
        thickness = self.clothing_offset - self.relief[self.sample_anchor][nearest]
        return thickness.clamp_max(MAX_CLOTHING_OFFSET)

    def _texel_mesh(self) -> Float[Tensor, "v 3"]:
        return texel_mesh(self.template, None if self.detail_height is None else self.detail_height.cpu())

    def add_slide(self, share: Float[Tensor, "n j"]) -> None:
        """Let what is painted slide over the skin, by these numbers."""
        self.slide = Slide(share)
        self._lay_slide()

    def raise_surface(self, height: Float[Tensor, " a"]) -> None:
        """Let the surface stand so many metres higher at each sample of the skin, along its normal at rest."""
        if self.relief is None:
            self.relief = self.clothing_offset.new_zeros(len(self.anchor_vertex))
        self.relief[self.sample_anchor] += height.to(self.relief)

    def _lay_slide(self) -> None:
        if self.slide is not None:
            nodes = self.template.v_template[self.node_vertex.cpu()].to(self.sample_rest)
            self.slide.lay(nodes, self.sample_rest, len(self.sample_anchor))

    def expect(self, state: Mapping[str, Tensor]) -> None:
        """Have the static detail, the slide and the outgrowth that a state to be loaded has, by its tensors' shapes, or none."""
        self.detail = self.slide = self.outgrowth = self.relief = self.detail_height = None
        if "detail.edge" in state:
            if "detail_height" in state:
                self.detail_height = state["detail_height"].float().clone()
            self.detail = DetailTexture(state["detail.edge"].clone())
            self.detail.requires_grad_(False).lay(self._texel_mesh(), self.template.faces)
        if "slide.share" in state:
            self.add_slide(state["slide.share"].float())
        if "relief" in state:
            self.relief = state["relief"].float().clone()
        if {"outgrowth.first", "outgrowth.distance"} <= set(state):
            joint = state.get("outgrowth.joint")
            joint = None if joint is None else joint.clone()
            anchor = state.get("outgrowth.anchor")
            anchor = None if anchor is None else anchor.float().clone()
            first, distance = state["outgrowth.first"].clone(), state["outgrowth.distance"].float()
            self.outgrowth = Outgrowth(first, distance, joint, anchor)
            self.outgrowth.lay(self.template.v_template)

    @property
    def appearance_channels(self) -> int:
        """Of the features of an `appearance`."""
        return self.widths.colour_feature + (0 if self.detail is None else 3)

    def code(self, body_rotations: Float[Tensor, "21 3 3"], latent: Float[Tensor, " z"] | None = None) -> BodyCode:
        """Node residuals and detail embeddings of a pose; `latent` None is z = 0, the test-time value."""
        code: BodyCode = self.code_network(body_rotations, latent)
        return code

    def frame(self, posed: PosedTemplate, code: BodyCode) -> BodyFrame:
        """Everything of this pose. `posed` is the body template with flat hands and a neutral face."""
        node_from_rest = self._onto(posed, self.node_weights, self.node_rest, self.node_vertex)
        node_rest = self.node_rest + code.residual
        position = (node_from_rest[:, :, :3] @ node_rest[:, :, None])[:, :, 0] + node_from_rest[:, :, 3]
        cover = covering_radius(posed.vertices.detach(), position.detach()) + CLOTH
        return BodyFrame(code, position, node_rest, node_from_rest, self._samples(posed), cover)

    def _samples(self, posed: PosedTemplate) -> Samples:
        """The anchors of the skin in this pose, then those of an outgrowth that hangs on a joint."""
        vertex, s = self.sample_vertex, len(self.sample_vertex)
        onto = self._onto(posed, self.sample_weights[:s], self.sample_rest[:s], vertex)
        onto = torch.cat([onto, blend(posed.skinning, self.sample_weights[s:])])
        outward = F.normalize((onto[:, :, :3] @ self.sample_normal[:, :, None])[:, :, 0], dim=-1)
        clothed = posed.vertices[vertex] + outward[:s] * self.clothing_offset[vertex, None]
        samples = Samples(
            self.sample_rest,
            torch.cat([clothed, skin(onto[s:], self.sample_rest[s:])]),
            outward,
            self._raised(invert_affine(onto)),
            self.sample_owner,
            ANCHOR_SIGMA * (2048 / s) ** 0.5,
            gate_rest=self.sample_gate_rest,
        )
        return self.slid(samples, posed.skinning)

    def _raised(self, rest_from_posed: Float[Tensor, "a 3 4"]) -> Float[Tensor, "a 3 4"]:
        """With the relief: what stands δ higher is looked up δ further in."""
        if self.relief is None:
            return rest_from_posed
        height = self.relief.new_zeros(len(self.sample_rest))
        height[: len(self.sample_anchor)] = self.relief[self.sample_anchor]
        offset = rest_from_posed[:, :, 3] - height[:, None] * self.sample_normal
        return torch.cat([rest_from_posed[:, :, :3], offset[:, :, None]], -1)

    def slid(self, samples: Samples, skinning: Float[Tensor, "k 4 4"]) -> Samples:
        """All `samples` of a pose with its slide."""
        if self.slide is None:
            return samples
        return replace(samples, slide=self.slide.offset(samples.rest_from_posed, skinning, samples.rest))

    def _onto(self, posed: PosedTemplate, weights: Tensor, rest: Tensor, vertex: Tensor) -> Float[Tensor, "n 3 4"]:
        """Per sample the linear part of its frame, with the offset that takes its rest position onto its posed vertex."""
        if self.local_frame == "turned":
            linear = blend_rotations(posed.skinning, weights, self.template.parents)
        else:
            linear = blend(posed.skinning, weights)[:, :, :3]
        offset = posed.vertices[vertex] - (linear @ rest[:, :, None])[:, :, 0]
        return torch.cat([linear, offset[:, :, None]], -1)

    def pairs(self, frame: BodyFrame, position: Float[Tensor, "p 3"]) -> Pairs:
        """All (point, node) pairs within the influence radius."""
        return find_pairs(position, frame.node_position, frame.among)

    def localise(
        self,
        frame: BodyFrame,
        position: Float[Tensor, "p 3"],
        pairs: Pairs,
        cutoff: float = 0.0,
        rest: Float[Tensor, "p 3"] | None = None,
        impl: str = "auto",
    ) -> tuple[Pairs, Float[Tensor, "k 3"], Float[Tensor, " k"]]:
        """Pairs that have weight, their local coordinates p_i (metres, rest pose) and their weights w_i.

        A pair with less than `cutoff` of its point's weight is left out; `rest`: the points' rest positions, where they have
        been found. `impl`: `auto`, `torch`.
        """
        if frame.among is not None:
            pairs = pairs.keep(frame.among[pairs.node])
        rest = frame.samples.rest_position(position) if rest is None else rest
        if impl == "auto" and native.serves(position, frame.node_position, frame.node_rest):
            return _localised(frame, position, rest, pairs, cutoff)
        point = take(position, pairs.point)
        squared = (point - take(frame.node_position, pairs.node)).square().sum(0)
        local = take(rest, pairs.point) - take(frame.node_rest, pairs.node)
        weight = influence(squared) * gate(local.square().sum(0))
        kept = weight > 0
        if cutoff:
            total = weight.new_zeros(len(position)).index_add(0, pairs.point, weight)
            kept = kept & (weight >= cutoff * total[pairs.point])
        keep = torch.nonzero(kept)[:, 0]
        if len(keep) < len(weight):
            pairs, local, weight = pairs.take(keep), local.index_select(1, keep), weight.index_select(0, keep)
        return pairs, local.T, weight

    def sdf(
        self,
        frame: BodyFrame,
        position: Float[Tensor, "p 3"],
        pairs: Pairs | None = None,
        impl: str = "auto",
    ) -> Float[Tensor, " p"]:
        """Signed distance in metres; `pairs` of these points, where they have been found."""
        pairs = self.pairs(frame, position) if pairs is None else pairs
        pairs, local, weight = self.localise(frame, position, pairs)
        coordinate = Encoding(local / RADIUS, COORDINATE_OCTAVES)
        feature = self.geometry_local([coordinate], frame.code.embedding, pairs.offsets, impl)
        mean, total = weighted_mean(feature, weight, pairs, len(position))
        inside: Tensor = SDF_UNIT * self.geometry_blend(mean[:, : self.widths.geometry_feature])[:, 0]
        missed = total <= 0
        if not missed.any():
            return inside
        fill = position.new_zeros(len(position))
        fill[missed] = self.outside_distance(frame, position[missed])
        return torch.where(missed, fill, inside)

    def outside_distance(self, frame: BodyFrame, position: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
        """(radius − cover) + distance to the nearest sphere: at most the true distance where no node reaches."""
        nodes = frame.node_position if frame.among is None else frame.node_position[frame.among]
        if not len(nodes):
            return torch.full_like(position[:, 0], torch.inf)
        nearest = torch.cdist(position.detach(), nodes.detach()).amin(1)
        return (nearest.clamp_min(RADIUS) - frame.cover).clamp_min(LEAST_FILL)

    def patches(self, frame: BodyFrame, nodes: Int[Tensor, " m"] | None = None) -> Float[Tensor, "m c s s"]:
        """Feature patches of all nodes, or of those listed (in their order)."""
        patches: Tensor = self.patch_network(frame.code.embedding, nodes)
        return patches

    def colour(
        self,
        frame: BodyFrame,
        patches: Float[Tensor, "n c s s"] | None,
        position: Float[Tensor, "p 3"],
        view_direction: Float[Tensor, "p 3"],
        pairs: Pairs | None = None,
        impl: str = "auto",
        light: Irradiance | None = None,
    ) -> Float[Tensor, "p 3"]:
        """sRGB in [0, 1] of surface points seen along unit `view_direction` (root frame, from the eye); in the `light` that
        falls on them, above 1 where it is bright, or as the networks say.

        `patches` None decodes those of the nodes in reach of the points, for this call alone.
        Where no node reaches, the colour of zero features: no such point lies on a surface.
        """
        pairs = self.pairs(frame, position) if pairs is None else pairs
        return self.seen(*self.appearance(frame, patches, position, pairs, impl, light), view_direction)

    def appearance(
        self,
        frame: BodyFrame,
        patches: Float[Tensor, "n c s s"] | None,
        position: Float[Tensor, "p 3"],
        pairs: Pairs,
        impl: str = "auto",
        light: Irradiance | None = None,
    ) -> tuple[Float[Tensor, "p f"], Float[Tensor, "p 3"] | None]:
        """What of `colour` belongs to the points alone, from wherever they are seen: Σ w_i 𝒞_i / Σ w_i, and the `light`
        that falls on them (None without one). The last three features are the logits of the static detail, where there is one.
        """
        beside = frame.samples.neighbours_of(position)
        rest = frame.samples.painted_position(position, beside)
        pairs, local, weight = self.localise(frame, position, pairs, self.widths.colour_cutoff, rest)
        feature = self._colour_features(frame, patches, pairs, local, impl)
        mean, _ = weighted_mean(feature, weight, pairs, len(position))
        if self.detail is not None:
            mean = torch.cat([mean, self.detail(self.detail.places(rest))], -1)
        return mean, None if light is None else light(frame.samples.facing(beside))

    def seen(
        self,
        feature: Float[Tensor, "p f"],
        light: Float[Tensor, "p 3"] | None,
        view_direction: Float[Tensor, "p 3"],
    ) -> Float[Tensor, "p 3"]:
        """The colour of an `appearance` along unit `view_direction`."""
        width = self.widths.colour_feature
        said = self.colour_blend.of_blocks([F.relu(feature[:, :width]), Encoding(view_direction, DIRECTION_OCTAVES)])
        colour = torch.sigmoid(said if self.detail is None else said + feature[:, width:])
        return colour if light is None else colour * light

    def _colour_features(
        self, frame: BodyFrame, patches: Tensor | None, pairs: Pairs, local: Float[Tensor, "k 3"], impl: str
    ) -> Float[Tensor, "k c"]:
        """𝒞_i(p_i, e_i, f_i) of every pair."""
        if self.colour_local is None:
            coordinate = Encoding(local / RADIUS, COORDINATE_OCTAVES)
            both: Tensor = self.geometry_local([coordinate], frame.code.embedding, pairs.offsets, impl)
            return both[:, self.widths.geometry_feature :]
        if patches is None:
            nodes = torch.nonzero(pairs.offsets.diff())[:, 0]
            decoded = self.patches(frame, nodes)
            patches = decoded.new_zeros(len(self.node_rest), *decoded.shape[1:]).index_copy(0, nodes, decoded)
        coordinate = Encoding(local / COLOUR_UNIT, COORDINATE_OCTAVES, GATE[1] / COLOUR_UNIT)
        blocks = [coordinate, patch_features(patches, pairs.node, self.node_axes, local)]
        feature: Tensor = self.colour_local(blocks, frame.code.embedding, pairs.offsets, impl)
        return feature


def _localised(
    frame: BodyFrame, position: Tensor, rest: Tensor, pairs: Pairs, cutoff: float
) -> tuple[Pairs, Tensor, Tensor]:
    """`BodyField.localise` by compiled loops."""
    count = len(pairs.point)
    local, weight, keep = torch.empty(3, count), torch.empty(count), torch.empty(count, dtype=torch.int64)
    tables = (pairs.point, pairs.node, position, rest, frame.node_position, frame.node_rest)
    arrays = loops.NodePairs(*(table.contiguous().numpy() for table in tables))
    support = loops.Support(*map(np.float32, (RADIUS, SIGMA, EPSILON, *GATE)))
    native.spread(loops.localise, count, arrays, support, local.numpy(), weight.numpy())
    total = np.zeros(len(position), np.float32)
    kept = loops.keep_supported(arrays.point, weight.numpy(), np.float32(cutoff), total, keep.numpy())
    if kept == count:
        return pairs, local.T, weight
    keep = keep[:kept]
    return pairs.take(keep), local.index_select(1, keep).T, weight.index_select(0, keep)


FILE_NAMES = {"clothing_offset": "worn"}
"""Buffers whose name in files of format 3 is another one."""


def _file_names(_: nn.Module, state: dict[str, Tensor], prefix: str, metadata: Any) -> None:
    for own, stored in FILE_NAMES.items():
        state[prefix + stored] = state.pop(prefix + own)


def _own_names(field: nn.Module, state: dict[str, Tensor], prefix: str, *rest: Any) -> None:
    assert isinstance(field, BodyField)
    for own, stored in FILE_NAMES.items():
        if prefix + stored in state:
            state[prefix + own] = state.pop(prefix + stored)
    field.expect({name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)})
