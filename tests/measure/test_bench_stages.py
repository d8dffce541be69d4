"""Every stage runs small and says something true; what is measured here is errors and counts, never time."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from avatarrex_studio.cli.main import main
from surface.template_surface import template_surface

from avatarrex.camera import Camera
from avatarrex.gl.context import current_context
from avatarrex.measure.bench import geometry, live, motion, raycast, raycast_peers, rivals, sdf, skinning
from avatarrex.measure.bench.raycast_peers import ray_error, truth
from avatarrex.measure.bench.report import Metric
from avatarrex.measure.bench.session import Bench
from avatarrex.measure.bench.stages import measure
from avatarrex.pointmap.rays import RayPlane, pixel_centres
from avatarrex.reference.solids import capsule_man
from avatarrex.surface.pose import pose_surface
from avatarrex.surface.raster import SurfacePicture, draw_surfaces, surface_geometry
from avatarrex.volume.sdf_volume import SdfVolume


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(quick=True, scale=0.05)


@pytest.fixture(scope="module")
def body_alone() -> Bench:
    """Without the boxes of hands and face, whose cost no image size changes, and without a surface, which has a test of its own."""
    bench = Bench(quick=True, scale=0.05)
    bench.avatar.meta["untrained"] = ["face", "left_hand", "right_hand"]
    bench.avatar.surface = None
    return bench


def run(stage: str, bench: Bench) -> dict[str, Metric]:
    return {metric.name: metric for metric in measure(stage, bench)}


def test_signed_distances_are_exact_and_judged_by_another(bench):
    found = run("sdf", bench)
    assert found["sdf.max_error_m"].met
    assert found["sdf.sign_errors"].value == 0
    assert found["sdf.hand.brute_force.ms"].error["max_error_m"] < 1e-5
    for case in sdf.cases(bench):
        assert np.isfinite(case.truth).sum() > 300
        assert case.error(-case.truth)["sign_errors"] > 100, "a flipped sign is seen"
        assert case.error(case.truth + 2e-6)["max_error_m"] > 1e-6, "two micrometres are seen"


def test_the_sliver_mesh_is_closed_and_thin():
    import trimesh

    mesh = trimesh.Trimesh(*sdf.sliver_mesh(), process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.pi * 0.05**2 * 0.3, rel=0.01)
    sides = mesh.edges_unique_length
    assert sides.min() / sides.max() < 2 * sdf.SLIVER


def test_local_networks_agree_with_the_equation(bench):
    found = run("mlp", bench)
    for name, metric in found.items():
        if name.endswith(".ms"):
            assert metric.error["max_error"] < 1e-4, name
    assert 0 < found["mlp.fraction_of_peak"].value < 1.5


def test_crossings_are_compared(bench):
    found = run("geometry", bench)
    assert found["geometry.changed_crossings"].error["of"] > 1000
    pairs = found["geometry.band_pairs"]
    assert 0 < pairs.error["least_without_a_changed_crossing"] <= pairs.value < 1
    assert 0 < found["geometry.pairlist_share"].value < 1


def test_bubbles_are_told_from_the_surface():
    full = np.ones((5, 5, 9), np.float32)
    full[:, :, :3] = -1
    full[2, 2, 1] = 1  # a void, and a floater of two voxels
    full[2, 2, 6:8] = -1
    band = np.where(np.arange(9) < 3, -0.02, 0.03) * np.ones((5, 5, 1))
    found = geometry.Bubbles.of(band, full, np.ones(band.shape, bool))
    assert (found.voids, found.floaters) == (1, 1)
    assert found.blind == pytest.approx(0.03)
    assert found.nearer == 1.0
    assert geometry.Bubbles.of(band[..., :3], full[..., :3], np.ones((5, 5, 3), bool)).nearer == 1.0
    assert geometry.Bubbles.of(full, full, np.ones(full.shape, bool)) == geometry.Bubbles(0, 0, 0.0, 0.0)


def test_a_crossing_that_moves_or_turns_is_changed():
    line = np.array([1.0, 1.0, -1.0, -1.0]).reshape(1, 1, 4)
    assert geometry.crossings_between(line, line, 0.02) == (0, 1, 0.0)
    shifted = geometry.crossings_between(line, np.array([1.0, 3.0, -1.0, -1.0]).reshape(1, 1, 4), 0.02)
    assert shifted == (0, 1, pytest.approx(0.02 * 0.25))
    assert geometry.crossings_between(line, np.array([1.0, -1.0, -1.0, -1.0]).reshape(1, 1, 4), 0.02)[0] == 2
    assert geometry.crossings_between(line, -line, 0.02)[0] == 1


def test_a_void_that_the_body_encloses_is_filled_and_a_dent_is_not():
    body = np.full((7, 7, 7), 0.5)
    body[1:6, 1:6, 1:6] = -0.5
    dented, hollow, filled = body.copy(), body.copy(), body.copy()
    dented[1:3, 3, 3] = 0.25
    np.testing.assert_array_equal(geometry.solid(dented), dented)
    hollow[3, 3, 3], filled[3, 3, 3] = 0.25, -0.25
    np.testing.assert_array_equal(geometry.solid(hollow), filled)


def test_rays_are_judged_by_the_walk_through_every_cell(bench):
    found = run("raycast", bench)
    assert found["raycast.mean_error_mm"].met
    assert found["raycast.missed_plus_false"].value == 0
    assert found["raycast.view1.sphere_tracing.ms"].error["p99_error_mm"] > found["raycast.p99_error_mm"].value


def test_ray_errors_count_both_ways():
    exact = np.array([1.0, 2.0, np.inf, np.inf])
    error = ray_error(np.array([1.001, np.inf, 3.0, np.inf]), exact)
    assert error["mean_error_mm"] == pytest.approx(1)
    assert (error["missed"], error["false"], error["hits"]) == (1, 1, 2)


def test_volumes_are_weighed(bench):
    found = run("volume", bench)
    assert found["volume.dense_difference_m"].met
    assert found["volume.fast.mib"].value < found["volume.mib"].value


def test_posing_is_exact_and_so_is_the_peer(bench):
    found = run("skinning", bench)
    assert found["skinning.max_error_m"].met
    assert found["skinning.template.dense.ms"].error["max_error_m"] < 1e-6
    assert skinning.contests(bench).best.name == "body"


def test_everything_is_new_in_every_frame(bench):
    moving = ("body_pose", "left_hand_pose", "right_hand_pose", "expression")
    for k in range(20):
        (before, azimuth), (after, turned) = (motion.everything(bench, n) for n in (k, k + 1))
        assert all(np.abs(getattr(after, name) - getattr(before, name)).max() > 1e-3 for name in moving)
        assert turned != azimuth
        (before, azimuth), (after, turned) = (motion.expressing(bench, n) for n in (k, k + 1))
        assert [name for name in moving if (getattr(after, name) != getattr(before, name)).any()] == ["expression"]
        assert turned == azimuth


def test_a_surface_is_drawn_and_judged():
    bench = Bench(quick=True, scale=0.2)
    bench.avatar.surface = template_surface(amplitude=0.02)
    found = {metric.name.removeprefix("frame."): metric for metric in live.of_the_surface(bench)}
    crowds = {f"live_{number}_avatars_512_fps": number for number in (1, 2, 4, 8)}
    fitted = found.pop("rival.fitted_template_512_fps").error
    assert {found.pop(name).error["avatars"]: None for name in crowds} == dict.fromkeys(crowds.values())
    assert {name: metric.target for name, metric in found.items()} == {
        "live_512_fps": 60, "live_1024_fps": 25, "live_view_512_fps": 100, "rival.clothed_mesh_512_fps": None,
    }  # fmt: skip
    for metric in found.values():
        assert 0 < metric.error["depth_mean_mm"] <= metric.error["depth_p99_mm"]
        assert metric.error["depth_mean_mm"] < 100
        assert 0.5 < metric.error["iou"] < 1
        assert metric.error["psnr_db"] > 5 < metric.error["picture_psnr_db"]
        assert metric.error["below_balanced_db"] > 0, "the template has not the subject's colours"
    rival, ours = found["rival.clothed_mesh_512_fps"].error, found["live_512_fps"].error
    assert rival["iou"] > ours["iou"], "the stand-in's corrections are noise"
    assert fitted["picture_psnr_db"] > ours["picture_psnr_db"] + 3, (
        "it has the subject's colours, the stand-in has none"
    )
    assert fitted["live_psnr_db"] == pytest.approx(ours["picture_psnr_db"])


def test_the_fitted_skin_is_nearer_to_the_mattes_than_the_naked_one():
    """In the pose that neither texture nor skin has seen."""
    bench = Bench(quick=True, scale=0.7)
    signals, picture = bench.once(rivals.unseen)
    camera = bench.camera(len(picture))
    matte = picture[..., 3] > 0.5
    share = []
    for mesh in (bench.once(rivals.mesh_drawer), bench.once(rivals.fitted_mesh)):
        drawn = mesh.draw(signals, camera).image[..., 3].numpy() > 0.5
        share.append((drawn & matte).sum() / (drawn | matte).sum())
    assert share[1] > share[0] + 0.02


def test_a_crowd_is_one_picture_with_everybody_in_it(bench, monkeypatch):
    surface, drawn = template_surface(), []
    bench.avatar.surface = surface
    monkeypatch.setattr(live, "draw_surfaces", lambda placed: drawn.append(placed) or draw_surfaces(placed))
    posed = live.crowd(bench, 3, 4, 96)
    assert [one.posed for one in drawn[0]] == list(posed)
    assert len({one.posed.key for one in drawn[0]}) == 3, "each in a pose of its own"
    columns = []
    for one in drawn[0]:
        hit = surface_geometry(one.posed, one.view).hit
        assert hit.any(0).sum() > 8
        assert not hit[[0, -1]].any(), "whole persons"
        columns.append(np.argwhere(hit)[:, 1].mean())
    assert columns == sorted(columns)
    assert columns[2] - columns[0] > 30


def test_frames_are_finished_and_not_read_back(bench, monkeypatch):
    surface, done = template_surface(), []
    avatar = replace(bench.avatar, surface=surface)

    @contextmanager
    def watched():
        with current_context() as context:
            yield SimpleNamespace(finish=lambda: done.append(context.finish()))

    monkeypatch.setattr(live, "current_context", watched)
    monkeypatch.setattr(SurfacePicture, "read", lambda *_: pytest.fail("a picture was read back"))
    frame, counters = None, []
    for k, change in enumerate((motion.everything, motion.everything, motion.turning, motion.turning)):
        signals, azimuth = change(bench, k)
        frame = live.finished(avatar, signals, bench.camera(32, azimuth), frame)
        counters.append(frame.counters)
    assert len(done) == 4
    assert all(one["surface_vertices"] > 0.9 * len(surface.vertices) for one in counters[:3])
    assert counters[3]["surface_vertices"] == 0, "the camera alone has turned"
    assert all(one["surface_triangles"] > 0 for one in counters)


def test_the_clothed_mesh_has_four_bones_and_no_corrections(bench):
    surface, person = template_surface(amplitude=0.02), bench.avatar.person
    game, signals = live.four_bones(surface), motion.everything(bench, 3)[0]
    assert game.joint.shape == game.weight.shape == (len(surface.vertices), 4)
    np.testing.assert_allclose(game.weight.sum(1), 1, atol=1e-6)
    shown = pose_surface(game, person, signals).vertices
    skinned = pose_surface(template_surface(), person, signals).vertices
    corrected = pose_surface(surface, person, signals).vertices
    assert np.linalg.norm(shown - skinned, axis=1).max() < 0.01
    assert np.linalg.norm(corrected - skinned, axis=1).max() > 0.03, "the stand-in's corrections are large"


def test_an_avatar_without_a_surface_has_a_note(bench):
    bench.avatar.surface = None
    assert live.of_the_surface(bench) == []
    assert "avatarrex-studio distil" in bench.absent["frame.live"]
    assert bench.absent["frame.rival.clothed_mesh"] == bench.absent["frame.live"]


@pytest.mark.slow
def test_whole_frames(body_alone):
    found = run("frame", body_alone)
    assert found["frame.idle_work"].value == 0
    assert found["frame.level.fast.ms"].error["flips"] < 0.2
    assert found["frame.new_pose_512_ms"].error["pixels"] > 5
    assert found["frame.rival.avatar.ms"].error["psnr_db"] > 5
    assert found["frame.vs_volume_rendering"].error["preset"] == "paper"
    assert found["frame.view_1024_fps"].error["networks"] == "cpu"
    assert found["frame.view_1024_fps"].met is None, "a target of a GPU"
    assert found["frame.vs_paper_level"].value > 0
    assert "frame.live" in body_alone.absent, "the surface is looked for"
    assert found["frame.everything_512_ms"].value == found["frame.everything_512.balanced.ms"].value
    assert (
        found["frame.everything_512.quality.ms"].error["depth_mean_mm"]
        < found["frame.everything_512_ms"].error["depth_mean_mm"]
    )
    wanted = {
        name: found[f"frame.{name}"].target for name in ("everything_512_ms", "expression_512_ms", "view_512_fps")
    }
    assert wanted == {"everything_512_ms": 250, "expression_512_ms": 120, "view_512_fps": 20}


@pytest.mark.slow
def test_training_steps_evaluate_few_samples(bench):
    found = run("training", bench)
    assert 0 < found["training.samples_per_ray"].value < 20
    assert found["training.samples_per_ray"].error["silhouette_rays"] > 0


@pytest.mark.slow
def test_growth_is_fitted(body_alone):
    found = run("growth", body_alone)
    assert len(found) == 4
    assert all(len(metric.error["ms"]) == len(metric.error["size"]) >= 3 for metric in found.values())


def test_peers_take_what_others_measured(bench):
    before = bench.once(sdf.contests)
    found = run("peers", bench)
    assert bench.once(sdf.contests) is before
    assert found["peers.sdf.hand.brute_force"].value == before[0].advantage("brute_force")
    assert "peers.mlp.colour.vmap" in found


def test_mitsuba_sees_the_same_surface():
    pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra `peers`)")
    volume = SdfVolume(capsule_man().body)
    camera = Camera.orbit(*raycast.ORBITS[0], (0, -0.05, 0), 128, 128)
    rays = RayPlane.of(camera, volume.middle).rays(pixel_centres(camera, torch.float64))
    exact, found = truth(volume, camera), raycast_peers.distances(volume.body, rays)
    error = ray_error(found, exact)
    assert error["hits"] > 1000
    assert error["missed"] + error["false"] <= 1e-3 * error["hits"]
    assert error["p99_error_mm"] <= 1e-3 * 1e3 * volume.body.voxel, "a thousandth of a voxel"
    differ = (np.isfinite(found) != np.isfinite(exact)).reshape(128, 128)
    assert not (differ & ~silhouette(np.isfinite(exact).reshape(128, 128))).any()


def silhouette(hit: np.ndarray) -> np.ndarray:
    """Pixels with a neighbour of the other kind."""
    edge = np.zeros_like(hit)
    for axis in range(2):
        turned = np.diff(hit.astype(int), axis=axis) != 0
        ends = [[slice(None)] * 2 for _ in range(2)]
        ends[0][axis], ends[1][axis] = slice(None, -1), slice(1, None)
        for end in ends:
            edge[tuple(end)] |= turned
    return edge


def test_the_command_measures_records_and_gates(tmp_path, capsys):
    words, record, out = ["bench", "skinning", "--quick"], tmp_path / "baseline.json", tmp_path / "run.json"
    old = [{"name": name, "value": 1.0, "unit": "mm"} for name in ("sdf.of_another_stage", "skinning.of_before")]
    record.write_text(json.dumps({"device": {}, "mode": "quick", "metrics": old}))
    assert main([*words, "--json", str(out), "--record", str(record)]) == 0
    data, recorded = (json.loads(path.read_text()) for path in (out, record))
    assert [metric["name"] for metric in recorded["metrics"][:1]] == ["sdf.of_another_stage"]
    assert recorded["metrics"][1:] == data["metrics"]
    assert data["mode"] == "quick"
    assert "skinning.max_error_m" in capsys.readouterr().out
    data["metrics"] = [metric for metric in data["metrics"] if metric["name"] == "skinning.max_error_m"]
    record.write_text(json.dumps(data))
    assert main([*words, "--gate", str(record)]) == 0
    assert "gate: 1 passed" in capsys.readouterr().out
    data["metrics"].append({**data["metrics"][0], "name": "skinning.no_longer_measured"})
    record.write_text(json.dumps(data))
    assert main([*words, "--gate", str(record)]) == 1
    assert "FAIL" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["wobble"], "wobble"),
        (["sdf", "ablation"], "ablation"),
        (["sdf", "--gate", "no_such.json"], "no_such.json"),
        (["sdf", "--json", ""], "--json"),
        (["frame", "--device", "xpu:7"], "--device"),
        (["training", "--capture", "nowhere"], "nowhere"),
    ],
)
def test_wrong_words_are_refused_before_any_work(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_device_that_is_none_is_refused_before_torch_is_loaded():
    words = [
        "-c",
        "import sys; from avatarrex.measure.__main__ import main; s = main(sys.argv[1:]); print('torch' in sys.modules); exit(s)",
    ]
    done = subprocess.run([sys.executable, *words, "bench", "--device", "cdua"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "False\n")
    assert done.stderr.endswith("--device: expected cpu, cuda, cuda:1, mps or xpu, found cdua\n")
    assert done.stderr.count("\n") == 1


def test_ablation_keeps_its_own_options(tmp_path, capsys):
    assert main(["bench", "ablation", str(tmp_path / "none"), "--out", str(tmp_path / "study"), "--seeds", "x"]) == 2
    assert "--seeds" in capsys.readouterr().err
