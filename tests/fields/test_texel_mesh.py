"""Texels lie where the clothes are: what follows each other on cloth does so on them."""

from __future__ import annotations

import numpy as np
import torch

from avatarrex.avatar_file import load_avatar
from avatarrex.fields.detail_texture import DetailTexture
from avatarrex.fields.membrane import membrane
from avatarrex.fields.texel_mesh import flattened, texel_height, texel_mesh
from avatarrex.ops.closest_triangle import closest_triangle
from avatarrex.ops.search_tree import SearchTree
from avatarrex.templates.model import EYES, TemplateModel
from avatarrex.templates.person import load_person

STEPS = 40
BODY = load_person().body


def walks(height: np.ndarray) -> np.ndarray:
    """(w, STEPS, 3) from triangle to triangle over edges of the trunk, on cloth that lies `height` along interpolated normals."""
    faces, rest, normal = BODY.faces.numpy(), BODY.v_template.double().numpy(), BODY.normals.double().numpy()
    trunk = (np.abs(rest[:, 0]) < 0.15) & (rest[:, 1] > -0.1) & (rest[:, 1] < 0.4)
    chosen = faces[trunk[faces].all(1)][::7]
    edges = np.concatenate([chosen[:, [0, 1, 2]], chosen[:, [1, 2, 0]]])
    owner = {(a, b): c for one in faces for a, b, c in (one, one[[1, 2, 0]], one[[2, 0, 1]])}
    quads = np.array([(a, b, c, owner[b, a]) for a, b, c in edges if (b, a) in owner])
    t = np.linspace(0, 1, STEPS)[None, :, None]

    def between(values: np.ndarray) -> np.ndarray:
        begin, middle, end = (values[quads[:, k]].mean(1)[:, None] for k in ([0, 1, 2], [0, 1], [0, 1, 3]))
        return np.where(t < 0.5, begin + 2 * t * (middle - begin), middle + (2 * t - 1) * (end - middle))

    outward = between(normal)
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    return np.asarray(between(rest) + between(height[:, None]) * outward)


def longest_step(mesh: torch.Tensor, places: np.ndarray) -> np.ndarray:
    """(w,) of the closest places on the mesh, in mean steps."""
    vertices, faces = mesh.numpy(), BODY.faces.numpy()
    face, weight = closest_triangle(SearchTree.of_triangles(vertices, faces), places.reshape(-1, 3))
    found = np.einsum("pk,pkc->pc", weight, vertices[faces[face]]).reshape(places.shape)
    step = np.linalg.norm(np.diff(found, axis=1), axis=-1)
    return np.asarray(step.max(1) / step.mean(1).clip(1e-9))


def test_places_on_cloth_follow_each_other() -> None:
    """Over a shirt that lies 15 to 20 mm off: on the skin one walk in ten jumps by six steps and more, on the texels' mesh hardly any."""
    rest = BODY.v_template.double().numpy()
    height = 0.0175 + 0.0025 * np.sin(20 * rest[:, 1])
    places = walks(height)
    assert len(places) > 200
    on_skin, on_cloth = (
        longest_step(texel_mesh(BODY, raised), places)
        for raised in (None, texel_height(BODY, torch.from_numpy(height)))
    )
    assert np.quantile(on_skin, 0.9) > 6
    assert np.quantile(on_cloth, 0.9) < 1.6


def test_without_a_height_texels_lie_on_the_skin() -> None:
    """Of avatars of before."""
    torch.testing.assert_close(texel_mesh(BODY, None), membrane(BODY.v_template, BODY.faces), rtol=0, atol=0)


def test_heights_are_even_and_never_below_the_skin() -> None:
    even = texel_height(BODY, torch.full((len(BODY.v_template),), 0.02))
    trunk = BODY.v_template[:, 0].abs() < 0.15
    trunk &= (BODY.v_template[:, 1] - 0.1).abs() < 0.3
    torch.testing.assert_close(even[trunk], torch.full_like(even[trunk], 0.02))
    drawn = torch.Generator().manual_seed(0)
    rough = 0.02 * torch.randn(len(BODY.v_template), generator=drawn)
    found = texel_height(BODY, rough)
    assert float(found.min()) >= 0
    assert float(found[BODY.of_groups(EYES)].max()) < 0.002
    assert float(found.std()) < 0.3 * float(rough.clamp_min(0).std())
    assert float(found.mean()) < 1.2 * float(rough.clamp_min(0).mean())


def test_the_packaged_avatars_texels_would_lie_in_its_shirt() -> None:
    """And still on bare skin."""
    body = load_avatar("default").body
    assert body.detail_height is None
    body.add_detail(0.02)
    assert isinstance(body.detail, DetailTexture)
    assert body.detail_height is not None
    template: TemplateModel = body.template
    chest = (template.v_template[:, 1] - 0.3).abs() < 0.05
    front = chest & (template.v_template[:, 2] > 0.05) & (template.v_template[:, 0].abs() < 0.1)
    raised = torch.from_numpy(body.detail.lattice.vertices) - template.v_template
    along = (raised * template.normals).sum(1)
    assert 0.004 < float(along[front].mean()) < 0.03
    torch.testing.assert_close(along[front], body.detail_height[front].double(), rtol=0.05, atol=1e-4)
    forearm = (template.v_template[:, 0].abs() - 0.53).abs() < 0.08
    assert float(raised[forearm].norm(dim=1).mean()) < 0.001
    eyes = template.of_groups(EYES)
    assert float(raised[eyes].norm(dim=1).max()) < 0.006  # what evening brings of lids


def test_folds_are_those_of_the_template() -> None:
    """And but between toes, which lie deep in shoes, hardly a triangle turns over."""
    flat = membrane(BODY.v_template, BODY.faces)
    mesh = texel_mesh(BODY, texel_height(BODY, load_avatar("default").body.clothing_offset))
    laid, raised = (
        torch.linalg.cross(v[BODY.faces[:, 1]] - v[BODY.faces[:, 0]], v[BODY.faces[:, 2]] - v[BODY.faces[:, 0]])
        for v in (flat, mesh)
    )
    turned = ((laid * raised).sum(1) < 0) & (BODY.v_template[BODY.faces].mean(1)[:, 1] > -0.8)
    assert int(turned.sum()) < 80
    moved = flattened(BODY)
    ear = (BODY.v_template[:, 0].abs() > 0.06) & ((BODY.v_template[:, 1] - 0.7).abs() < 0.04)
    assert 0.01 < float(moved[ear].max()) < 0.03
    trunk = (BODY.v_template[:, 0].abs() < 0.15) & ((BODY.v_template[:, 1] - 0.1).abs() < 0.3)
    assert float(moved[trunk].max()) == 0


def test_texels_lie_where_the_surface_was_before_its_relief() -> None:
    """It is looked up there: p̄ has not the relief, `clothing_offset` has."""
    body = load_avatar("default").body
    body.add_detail(0.05)
    assert body.detail_height is not None
    before = body.detail_height.clone()
    body.raise_surface(torch.full((len(body.sample_rest),), 0.005))
    body.clothing_offset += 0.005
    body.add_detail(0.05)
    seen = (before > 0.002) & (before < 0.03)
    torch.testing.assert_close(body.detail_height[seen], before[seen], rtol=0.05, atol=5e-4)
