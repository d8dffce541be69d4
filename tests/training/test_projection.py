"""Pictures onto the body: its texture before pass II, and what stands off it."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import grey_dilation, grey_erosion
from scipy.spatial.transform import Rotation
from training.miniature import perturbed, write_miniature

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.fit.check import posed_in_world, silhouette
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.rigs import Rig, View, open_capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.fields.detail_texture import DetailTexture, TexelPlaces
from avatarrex.parts.face import Face, FaceState
from avatarrex.signals.driving import Signals
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person
from avatarrex.templates.posed import PosedPerson
from avatarrex.training.core import projection
from avatarrex.training.core.carving import carve
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.projection import Picture, Projected, lit_pixels, paint, project, start_from_pictures

HIDDEN = frozenset({"face", "left_hand", "right_hand"})


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    """Frames of the prior's surface, with texels from the miniature's training pictures."""
    rig = sealed(open_capture(write_miniature(tmp_path_factory.mktemp("capture"), "body")), "train").rigs["body"]
    avatar = perturbed("body", 0)
    avatar.measure_clothing_offset()
    store = FrameStore(avatar, rig, "body", HIDDEN, True)
    store.renew(0)
    start_from_pictures(avatar, "body", store, 0.01, slides=True, rises=True)
    return store


@pytest.fixture(scope="module")
def painted(store: FrameStore) -> Avatar:
    return store.avatar


def test_the_pattern_is_where_it_is(painted: Avatar) -> None:
    """The miniature's pattern is a function of the rest position; cameras of 96 x 128 see 15 mm a pixel."""
    detail = painted.body.detail
    assert detail is not None
    place = detail.lattice.position
    true = 0.5 + 0.4 * np.sin(25.0 * place + np.array([0.0, 1.0, 2.0]))
    off = np.abs(torch.sigmoid(detail.texel).detach().numpy() - true)
    chest = (np.abs(place[:, 0]) < 0.12) & (place[:, 1] > 0) & (place[:, 1] < 0.35) & (np.abs(place[:, 2]) > 0.06)
    assert chest.sum() > 300
    assert np.median(off[chest]) < 0.06


def test_frames_have_slide_and_relief(store: FrameStore) -> None:
    anew = FrameStore(store.avatar, store.rig, "body", HIDDEN, True)
    anew.renew(0)
    before, now = (one[0].volume.body_frame.samples for one in (store, anew))
    relief = store.avatar.body.relief
    assert before.slide is not None
    assert now.slide is not None
    assert relief is not None
    assert now.slide.norm(dim=1).mean() > 1e-4
    assert relief.abs().mean() > 1e-4
    assert torch.equal(before.slide, now.slide)
    assert torch.equal(before.rest_from_posed, now.rest_from_posed)


def test_a_wider_matte_wants_a_surface_that_stands_higher(store: FrameStore) -> None:
    """By a pixel, 15 mm here; a border that is off by more than 20 mm does not count, so that medians move by less."""
    misses, pixel = [], []
    for pair in store.pairs[:6]:
        picture = Picture.of(store, *pair)
        matte = picture.matte.numpy()
        mattes = (grey_erosion(matte, (3, 3)), matte, grey_dilation(matte, (3, 3)))
        misses.append([replace(picture, matte=torch.from_numpy(one)).silhouette().miss for one in mattes])
        pixel.append(float(picture.seen.depth[picture.seen.hit].mean()) / picture.camera.intrinsics[0, 0])
        beside = torch.ones_like(picture.seen.part_weight)
        assert not len(replace(picture, seen=replace(picture.seen, part_weight=beside)).silhouette().miss)
    narrower, own, wider = (float(torch.cat(each).median()) / np.mean(pixel) for each in zip(*misses))
    assert abs(own) < 0.5
    assert narrower < own - 0.3
    assert wider > own + 0.3


def test_a_raised_surface_is_met_by_the_same_rays_nearer_the_eye(store: FrameStore) -> None:
    index, view = store.pairs[0]
    one = Picture.of(store, index, view).sighting("body")
    eye = torch.as_tensor(store[index].camera(store.rig.views[view].camera).centre).float()
    higher = one.raised(torch.full((len(one.position),), 0.01))
    was, now = one.position - eye, higher.position - eye
    torch.testing.assert_close(one.gaze.float(), torch.nn.functional.normalize(was.float(), dim=1), atol=1e-5, rtol=0)
    assert torch.nn.functional.cosine_similarity(was, now, dim=1).min() > 1 - 1e-6
    nearer = was.norm(dim=1) - now.norm(dim=1)
    assert torch.allclose(
        nearer * one.weight.sqrt(), torch.full_like(nearer, 0.01), atol=1e-5
    )  # the weight is the squared cosine


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    """The same of the face, which has a light of its own."""
    rig = sealed(open_capture(write_miniature(tmp_path_factory.mktemp("face"), "face")), "train").rigs["face"]
    avatar = perturbed("face", 0)
    avatar.light.frame = "world"
    avatar.light.add_face()
    store = FrameStore(avatar, rig, "face", HIDDEN - {"face"}, True)
    store.renew(0)
    start_from_pictures(avatar, "face", store, 0.01)
    return store


def test_a_face_is_painted_along_the_gaze_that_it_was_seen_along(
    faces: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the head's frame."""
    given: list[torch.Tensor] = []

    def places(face: Face, state: FaceState, position: torch.Tensor, gaze: torch.Tensor) -> tuple[TexelPlaces, ...]:
        given.extend((position, gaze))
        return found(face, state, position, gaze)

    found = Face.places
    monkeypatch.setattr(Face, "places", places)
    index, view = faces.pairs[0]
    one = Picture.of(faces, index, view).sighting("face")
    lit_pixels(faces.avatar, one, "face")
    head_from_root = torch.from_numpy(np.linalg.inv(one.posed.root_from_part("face"))).float()
    centre = torch.as_tensor(faces[index].camera(faces.rig.views[view].camera).centre).float()
    position, gaze = (each.float() for each in given)
    eye = head_from_root[:3, :3] @ centre + head_from_root[:3, 3]
    torch.testing.assert_close(gaze, torch.nn.functional.normalize(position - eye, dim=1), atol=1e-4, rtol=0)


def test_a_mouth_that_no_picture_shows_is_black_and_no_lip_has_its_colours(faces: FrameStore) -> None:
    detail, sheets = faces.avatar.face.detail, faces.avatar.face.sheets
    assert detail is not None
    assert sheets is not None
    sheet = sheets.of_texels(detail.edge)
    assert 0.1 < sheet.float().mean() < 0.6
    lip = torch.nonzero(sheet == 0)[:, 0]
    seen = Projected(lip[:-5, None], torch.ones(len(lip) - 5, 1), torch.full((len(lip) - 5, 3), 0.5))
    before = detail.texel.detach().clone()
    try:
        paint(detail, [seen], "here", 0, sheet)
        albedo = torch.sigmoid(detail.texel.detach())
    finally:
        detail.texel.detach().copy_(before)
    assert (albedo[sheet == 1] < 0.01).all()
    torch.testing.assert_close(albedo[sheet == 0], torch.full((len(lip), 3), 0.5), atol=1e-4, rtol=0)


@pytest.mark.parametrize("part", ["body", "face"])
def test_light_falls_on_pixels_as_they_are_turned_in_the_world(request: pytest.FixtureRequest, part: str) -> None:
    """A person who is turned: normals are the surface's, and what is divided out is what a picture shows."""
    store: FrameStore = request.getfixturevalue("store" if part == "body" else "faces")
    avatar, world = store.avatar, np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.3, 1.2, -0.4]).as_matrix()
    one = replace(Picture.of(store, *store.pairs[0]).sighting(part), world_from_root=world)
    kept = {name: value.clone() for name, value in avatar.light.state_dict().items()}
    with torch.no_grad():
        for harmonics in avatar.light.parameters():
            harmonics.normal_(0.0, 0.1, generator=torch.Generator().manual_seed(len(kept)))
    avatar.light.frame = "root"
    normal = lit_pixels(avatar, one, part).normal
    avatar.light.frame = "world"
    facing = (normal * one.parallax).sum(1) * one.weight.sqrt()  # the weight is the squared cosine
    assert (facing - one.weight.sqrt()).abs().median() < (0.02 if part == "face" else 0.2)
    turned = lit_pixels(avatar, one, part).normal
    torch.testing.assert_close(turned, normal @ torch.from_numpy(world[:3, :3]).float().T, atol=1e-5, rtol=0)
    light = avatar.light.over(world)
    expected = light.on_face(normal) if part == "face" else light(normal)
    albedo = project(avatar, one, part).albedo
    inside = ((albedo > 0) & (albedo < 1)).all(1)
    assert inside.float().mean() > 0.5
    torch.testing.assert_close((albedo * expected)[inside], one.colour[inside], atol=1e-5, rtol=0)
    avatar.light.load_state_dict(kept)


def test_normals_of_a_face_turn_with_the_head(faces: FrameStore, monkeypatch: pytest.MonkeyPatch) -> None:
    avatar, turn, placed = faces.avatar, np.eye(4), PosedPerson.root_from_part
    turn[:3, :3] = Rotation.from_rotvec([0.2, -0.6, 0.3]).as_matrix()
    rotation = torch.from_numpy(turn[:3, :3]).float()
    one = replace(Picture.of(faces, *faces.pairs[0]).sighting("face"), world_from_root=np.eye(4))
    upright = lit_pixels(avatar, one, "face").normal
    monkeypatch.setattr(PosedPerson, "root_from_part", lambda self, name: turn @ placed(self, name))
    turned = lit_pixels(avatar, replace(one, position=one.position @ rotation.T), "face").normal
    assert (turned * (upright @ rotation.T)).sum(1).median() > 0.9999


@pytest.mark.parametrize("part", ["body", "face"])
def test_a_part_is_painted_in_the_light_that_was_found(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    store: FrameStore = request.getfixturevalue("store" if part == "body" else "faces")
    avatar, albedo = store.avatar, {}
    field, (light,) = avatar.body if part == "body" else avatar.face, avatar.light.learnt_with(part)
    kept, before = field.detail, light.detach().clone()
    try:
        for brightness in (0.0, 0.2):
            lamp = torch.zeros(8, 3)
            lamp[2] = brightness
            monkeypatch.setattr(projection, "fit_light", lambda harmonics, pictures, texels, lamp=lamp: lamp)
            start_from_pictures(avatar, part, store, 0.01)
            assert light.tolist() == lamp.tolist()
            assert field.detail is not None
            albedo[brightness] = torch.sigmoid(field.detail.texel).detach()
        depth = torch.from_numpy(field.detail.lattice.position)[:, 2]
        front = depth.topk(len(depth) // 25).indices  # more than a toe, which few pixels show
        assert (albedo[0.2][front] / albedo[0.0][front]).median() < 0.94, "what is lit from the front is painted darker"
    finally:
        field.detail = kept
        light.detach().copy_(before)


def test_a_light_is_found_from_its_own_rig(store: FrameStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another rig, whose pictures are painted, too, stands in another light."""
    counts, kept, before = [], store.avatar.body.detail, store.avatar.light.harmonics.detach().clone()
    monkeypatch.setattr(projection, "fit_light", lambda harmonics, seen, texels: counts.append(len(seen)) or harmonics)
    monkeypatch.setattr(projection, "PICTURES", {"body": 6, "face": 2})
    try:
        for close in (None, copy(store)):
            monkeypatch.setattr(store, "close", close)
            start_from_pictures(store.avatar, "body", store, 0.01)
    finally:
        store.avatar.body.detail = kept
        store.avatar.light.harmonics.detach().copy_(before)
    assert len(store.pairs) > 6
    assert counts == [6, 3], "of two rigs half each"


def test_a_large_picture_gives_some_of_its_pixels(store: FrameStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """By chance and the same each time, each with its own colour, weight and parallax."""
    picture = Picture.of(store, *store.pairs[0])
    whole = picture.sighting("body")
    monkeypatch.setattr(projection, "EACH", 200)
    some, again = (picture.sighting("body") for _ in range(2))
    assert len(some.position) == 200
    assert len(whole.position) > 400
    assert torch.equal(some.position, again.position)
    rows = (whole.position == some.position[:, None]).all(-1).nonzero()[:, 1]
    for name in ("colour", "weight", "parallax"):
        assert torch.equal(getattr(whole, name)[rows], getattr(some, name)), name
    assert (some.position.std(0) / whole.position.std(0) - 1).abs().max() < 0.2, "of the whole person"


def test_the_networks_begin_at_nothing(painted: Avatar) -> None:
    assert all(not parameter.any() for parameter in painted.body.colour_blend[-1].parameters())


def test_what_moved_over_a_texel_does_not_count() -> None:
    vertices, faces = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]])
    detail = DetailTexture.of(vertices, faces, 5.0, torch.ones(1, dtype=torch.bool))
    texel, even = torch.tensor([[0, 1, 2]]), torch.full((1, 3), 1 / 3)
    seen = [Projected(texel, even, torch.full((1, 3), grey)) for grey in (0.4, 0.42, 0.38, 0.4, 0.9)]
    paint(detail, seen, "here")
    assert torch.sigmoid(detail.texel).amax() < 0.42  # the plain mean is 0.5


class Mattes(Pictures):
    """White on black, by (view, frame)."""

    def __init__(self, mattes: dict[tuple[int, int], np.ndarray]) -> None:
        self.mattes = mattes

    def get(self, kind: str, view: int, frame: int) -> np.ndarray:
        return self.mattes[view, frame]

    def check_size(self, view: int, frame: int) -> None: ...


def rig_with(balls: list[tuple[np.ndarray, float]], frames: tuple[Signals, ...] = (Signals.rest(),)) -> Rig:
    """Eight cameras around the template with balls (centre, radius) that turn with the head."""
    person = load_person()
    faces, head = person.body.faces.numpy(), person.body.joint_names.index("head")
    cameras = [Camera.orbit(azimuth, 5, 3.0, 40, (0, -0.05, 0), 160, 160) for azimuth in range(0, 360, 45)]
    mattes = {}
    for frame, signals in enumerate(frames):
        posed, _ = posed_in_world(person, signals)
        moved = posed.skinning[head].double().numpy()
        for number, camera in enumerate(cameras):
            matte = silhouette(posed.vertices.double().numpy(), faces, camera)
            column, row = np.meshgrid(np.arange(160) + 0.5, np.arange(160) + 0.5)
            for centre, radius in balls:
                (pixel,), (depth,) = camera.pixels((moved[:3, :3] @ centre + moved[:3, 3])[None])
                matte = matte | (np.hypot(column - pixel[0], row - pixel[1]) < radius * camera.intrinsics[0, 0] / depth)
            mattes[number, frame] = np.uint8(255) * matte
    views = tuple(View(f"c{number}", camera) for number, camera in enumerate(cameras))
    nobody: frozenset[int] = frozenset()
    return Rig("body", views, SignalSequence(frames, 1.0), frozenset(), nobody, nobody, Mattes(mattes))


@pytest.mark.slow
def test_a_bun_is_carved_and_skin_is_not() -> None:
    avatar = Avatar.create(load_person(), "compact")
    rest = avatar.person.body.v_template.double().numpy()
    crown = rest[rest[:, 1].argmax()]
    bun = crown + np.array([0, 0.05, -0.05])
    assert carve(avatar, rig_with([])) is None
    found = carve(avatar, rig_with([(bun, 0.05)]))
    assert found is not None
    points = found.points()
    assert np.linalg.norm(points - bun, axis=1).max() < 0.075
    assert np.linalg.norm(points.mean(0) - bun) < 0.03


@pytest.mark.slow
def test_a_pony_tail_hangs_on_the_head_to_its_end() -> None:
    """Its end is next to the back, which stays where it is when the head turns."""
    avatar = Avatar.create(load_person(), "compact")
    names = avatar.person.body.joint_names
    head = avatar.person.body.joint_template[names.index("head")].double().numpy()
    tail = [(head + np.array([0, 0.06 - 0.02 * k, -0.12]), 0.035) for k in range(12)]
    turns = (np.array([0, 0.6, 0]), np.array([0, -0.6, 0]), np.array([0.3, 0, 0]))
    frames = []
    for turn in turns:
        pose = np.zeros((21, 3))
        pose[names.index("head") - 1] = turn
        frames.append(Signals.rest().replace(body_pose=pose))
    found = carve(avatar, rig_with(tail, tuple(frames)))
    assert found is not None
    assert found.joint is not None
    assert names[int(found.joint)] == "head"
    assert found.anchor is not None
    assert np.abs(found.anchor.numpy()[:, None] - found.points()).max(2).min(1).max() < 0.01, "on it"
    assert found.points()[:, 1].min() < tail[-1][0][1] + 0.02, "to its end"
