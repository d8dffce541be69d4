"""Pictures onto the body: its texture before pass II, and what stands off it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import grey_dilation, grey_erosion
from training.miniature import perturbed, write_miniature

from avatarrex.avatar import Avatar
from avatarrex.camera import Camera
from avatarrex.capture.fit.check import posed_in_world, silhouette
from avatarrex.capture.readers.images_store import Pictures
from avatarrex.capture.readers.rigs import Rig, View, open_capture
from avatarrex.capture.readers.splits import sealed
from avatarrex.fields.detail_texture import DetailTexture
from avatarrex.signals.driving import Signals
from avatarrex.signals.sequence import SignalSequence
from avatarrex.templates.person import load_person
from avatarrex.training.core.carving import carve
from avatarrex.training.core.frames import FrameStore
from avatarrex.training.core.projection import Picture, Projected, paint, start_from_pictures

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
    assert torch.nn.functional.cosine_similarity(was, now, dim=1).min() > 1 - 1e-6
    nearer = was.norm(dim=1) - now.norm(dim=1)
    assert torch.allclose(
        nearer * one.weight.sqrt(), torch.full_like(nearer, 0.01), atol=1e-5
    )  # the weight is the squared cosine


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
    assert found.points()[:, 1].min() < tail[-1][0][1] + 0.02, "to its end"
