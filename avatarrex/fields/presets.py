"""Widths of every network, in two frozen presets (paper sec. 3.1–3.3 and the appendix's training statistics).

`paper` meets the paper's parameter counts within ±10 %: body geometry side 0.98 M, body and hand colour side 17.57 M,
face geometry 0.66 M, face colour 1.10 M. The paper gives no layer widths in its text: these are our choice.
`compact` serves machines without a GPU: a few million parameters, at most 16 MB in half precision for the whole avatar.
Each has variants for ablations, `PRESET/VARIANT` (docs/ablations.md); an avatar made of one is stored and loaded as any.

Letters: n nodes, e channels of a detail embedding, m octaves of the encoding, c channels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

COORDINATE_OCTAVES = 6
"""m of γ for coordinates: 3·(1 + 2·6) = 39 channels."""
DIRECTION_OCTAVES = 4
"""m of γ for view directions: 27 channels."""


@dataclass(frozen=True)
class BodyWidths:
    """Body field: hidden layers are tuples, inputs and outputs follow from the field."""

    nodes: int
    anchors: int
    """Skinned samples of the template that carry the local frames (`turned` and `anchors`, local_frame.py)."""
    embedding: int
    """e: channels of a node's detail embedding."""
    latent: int
    """Channels of the latent z, and of a frame's own code in training."""
    decoder: tuple[int, ...]
    encoder: tuple[int, ...]
    geometry_local: tuple[int, ...]
    geometry_feature: int
    geometry_blend: tuple[int, ...]
    patch_encoding: int
    """Channels of the learnable 2-D positional encoding, 32×32 per node."""
    patch_hidden: tuple[int, ...]
    patch_feature: int
    """0: no feature patches."""
    colour_local: tuple[int, ...] | None
    """None: colour features come from the geometry's local networks."""
    colour_feature: int
    colour_blend: tuple[int, ...]
    colour_cutoff: float
    """The colour of a node with a smaller share w_i/Σw of a pixel is not evaluated."""


@dataclass(frozen=True)
class HandWidths:
    """Hand colour MLP: 178 = γ(canonical point) 39 + normal 3 + signed distance 1 + φ 135 → hidden → 3."""

    hidden: tuple[int, ...]


@dataclass(frozen=True)
class FaceWidths:
    """Face: U-Net channels per level from 256² down, of one plane, MLP hidden layers; tone 54 → hidden → 9.

    No levels: no tri-planes, but MLPs on the point and the face's coefficients."""

    stem: int
    """Stride of the U-Nets' first convolution: planes of 256/stem texels."""
    geometry_levels: tuple[int, ...]
    geometry_planes: int
    geometry_mlp: tuple[int, ...]
    colour_levels: tuple[int, ...]
    colour_planes: int
    colour_mlp: tuple[int, ...]
    tone: tuple[int, ...]


@dataclass(frozen=True)
class Preset:
    """All widths of an avatar's fields."""

    name: str
    body: BodyWidths
    hand: HandWidths
    face: FaceWidths


PAPER = Preset(
    "paper",
    BodyWidths(
        nodes=128,
        anchors=2048,
        embedding=16,
        latent=16,
        decoder=(64, 64),
        encoder=(64, 64),
        geometry_local=(48, 48),
        geometry_feature=16,
        geometry_blend=(64, 64),
        patch_encoding=64,
        patch_hidden=(48, 48),
        patch_feature=16,
        colour_local=(64, 64),
        colour_feature=32,
        colour_blend=(64, 64),
        colour_cutoff=0.0,
    ),
    HandWidths(hidden=(128, 128, 128)),
    FaceWidths(
        stem=1,
        geometry_levels=(16, 28, 48, 64),
        geometry_planes=16,
        geometry_mlp=(64, 64),
        colour_levels=(16, 32, 64, 84),
        colour_planes=16,
        colour_mlp=(128, 128, 64),
        tone=(32,),
    ),
)

COMPACT = Preset(
    "compact",
    replace(
        PAPER.body,
        embedding=8,
        latent=8,
        geometry_local=(32, 32),
        geometry_feature=8,
        geometry_blend=(32,),
        patch_encoding=16,
        patch_hidden=(16,),
        patch_feature=8,
        colour_local=(32,),
        colour_feature=16,
        colour_blend=(32,),
        colour_cutoff=0.01,
    ),
    HandWidths(hidden=(64, 64)),
    FaceWidths(
        stem=2,
        geometry_levels=(16, 24, 32, 48),
        geometry_planes=12,
        geometry_mlp=(48, 48),
        colour_levels=(16, 24, 32, 48),
        colour_planes=12,
        colour_mlp=(64, 64),
        tone=(16,),
    ),
)


def _variants(preset: Preset, one_network: int, face_mlp: tuple[int, int]) -> tuple[Preset, ...]:
    """The preset and its ablations; widths of equal parameter count: of hidden layers of the one local network, and of
    the face's geometry and colour MLPs."""
    plain = replace(preset.body, patch_feature=0)
    shared = replace(plain, geometry_local=(one_network, one_network), colour_local=None)
    geometry, colour = ((width,) * 4 for width in face_mlp)
    without = replace(
        preset.face, geometry_levels=(), geometry_planes=0, geometry_mlp=geometry, colour_levels=(), colour_planes=0,
        colour_mlp=colour,
    )  # fmt: skip
    changes: dict[str, dict[str, Any]] = {
        "no-patches": {"body": plain}, "one-network": {"body": shared}, "face-mlp": {"face": without},
    }  # fmt: skip
    return preset, *(replace(preset, name=f"{preset.name}/{name}", **change) for name, change in changes.items())


PRESETS = {preset.name: preset for preset in (*_variants(PAPER, 83, (452, 584)), *_variants(COMPACT, 42, (333, 331)))}
BASES = tuple(name for name in PRESETS if "/" not in name)
"""Those that are no variants."""
