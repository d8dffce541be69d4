"""The face rig's pictures for the body: how often they are drawn, and in whose exposure."""

from pathlib import Path

import numpy as np
import pytest
from training.miniature import write_miniature

from avatarrex.avatar import Avatar
from avatarrex.capture.readers.rigs import Capture, Rig, open_capture
from avatarrex.errors import InputError
from avatarrex.templates.person import load_person
from avatarrex.training.core.exposure import LARGEST, exposed, exposed_as, gain, gain_to, one_exposure
from avatarrex.training.core.frames import FrameStore


def seen(count: int = 200) -> np.ndarray:
    return np.random.default_rng(0).uniform(40, 200, (count, 3))


def test_the_gain_is_the_median_ratio_of_what_both_see() -> None:
    wanted, own = np.array([0.8, 1.0, 1.25]), seen()
    other = own * wanted
    other[:20] *= 3  # something that moved
    own[50], other[60] = np.nan, np.nan
    np.testing.assert_allclose(gain(own, other), wanted)


def test_dark_triangles_say_nothing() -> None:
    own = np.concatenate([seen(), np.full((500, 3), 3.0)])
    other = np.concatenate([seen() * 1.2, np.full((500, 3), 9.0)])
    np.testing.assert_allclose(gain(own, other), 1.2)


def test_few_triangles_say_nothing_and_the_gain_is_bounded() -> None:
    assert gain(seen(99), 1.5 * seen(99)) is None
    np.testing.assert_allclose(gain(seen(), 5 * seen()), LARGEST)
    assert gain(np.full((300, 3), np.nan), seen(300)) is None


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Rig]:
    """Two rigs that see the same colours."""
    made = []
    for name in ("one", "two"):
        folder: Path = tmp_path_factory.mktemp(name)
        made.append(open_capture(write_miniature(folder, "face")).rigs["face"])
    return made[0], made[1]


def test_pictures_come_in_the_other_rigs_exposure(rigs: tuple[Rig, Rig]) -> None:
    dimmed = np.array([0.7, 0.8, 0.9])
    dim = exposed(rigs[0], dimmed)
    assert np.abs(dim.image(0, 0) - rigs[0].image(0, 0) * dimmed).max() <= 0.5
    np.testing.assert_array_equal(dim.matte(0, 0), rigs[0].matte(0, 0))
    found = gain_to(dim, rigs[1], load_person())
    np.testing.assert_allclose(found, 1 / dimmed, rtol=0.02)
    bright = exposed_as(dim, rigs[1], load_person()).image(0, 0)
    assert np.abs(bright - np.clip(dim.image(0, 0) * found, 0, 255)).max() <= 0.5


def test_without_colours_in_common_a_training_changes_nothing_and_a_measurement_is_refused(
    rigs: tuple[Rig, Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("avatarrex.training.core.exposure.gain_to", lambda *_: None)
    same = exposed_as(*rigs, load_person())
    np.testing.assert_array_equal(same.image(0, 0), rigs[0].image(0, 0))
    capture = Capture(Path("two"), {"body": rigs[0], "face": rigs[1]}, load_person(), {}, ())
    with pytest.raises(InputError, match=r"--exposed-as: expected 100 triangles .* found no colours in common"):
        one_exposure(capture, "body", load_person())


def test_a_share_of_the_pictures_is_the_other_rigs(rigs: tuple[Rig, Rig]) -> None:
    store = FrameStore(Avatar.create(load_person(), "compact", 0), rigs[0], "body", frozenset())
    rng = np.random.default_rng(0)
    assert all(store.drawn(rng, 0.25)[0] is store for _ in range(50)), "no other rig"
    plain = [store.drawn(np.random.default_rng(k), 0.0)[1:] for k in range(20)]
    store.close = FrameStore(store.avatar, rigs[1], "body", frozenset())
    assert [store.drawn(np.random.default_rng(k), 0.0)[1:] for k in range(20)] == plain, "the same draws without it"
    found = np.mean([store.drawn(rng, 0.25)[0] is store.close for _ in range(2000)])
    assert found == pytest.approx(0.25, abs=0.03)
    store.renew(7)
    assert store.close.age == 7
