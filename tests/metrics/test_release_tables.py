"""Tables of docs/results.md are those of the figures in docs/figures/, by the commands that tools/release_figures.py has now."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "docs" / "figures").glob("*.json"))
MEASURES = ("psnr", "psnr_matte", "ssim", "ssim_matte", "ms_ssim", "ms_ssim_matte", "iou", "sharpness")
RIVALS = ("fitted textured mesh", "fitted mesh, fine texels", "fitted mesh, own face")


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import release_figures

    yield release_figures
    for name in ("release_figures", "release_tables"):
        del sys.modules[name]


def figures() -> dict[str, Any]:
    """The avatar has 20 everywhere, meshes 1, 2 and 3 less; cameras that were held out cost it 4, a mesh 0.5."""
    values = {"avatar": 20.0} | {name: 19.0 - k for k, name in enumerate(RIVALS)}
    pose = {name: {"pictures": 3, **dict.fromkeys(MEASURES, value)} for name, value in values.items()}
    both = {name: {"pictures": 1, **dict.fromkeys(MEASURES, value)} for name, value in values.items()}
    both["avatar"]["psnr_matte"], both[RIVALS[0]]["psnr_matte"] = 16.0, 18.5
    part = {
        "splits": {"held-out pose": pose},
        "surface": {"held-out pose": {"avatar": {"to_truth": {"mean_mm": 1.26, "p95_mm": 4.0}}}},
    }
    body = {"splits": {"held-out pose": pose, "held-out both": both}, "surface": {}}
    found = {"trained_by": "abc1234", "seed": 5, "training_minutes": 25, "machine": "a machine", "date": "2026-01-02"}
    found["regions"] = {
        "pictures": {"eyes": {"avatar": {"psnr": 26.161, "ssim": 0.8014, "sharpness": 0.8, "pictures": 7}}}
    }
    found["capture_key"] = "0123456789abcdef"
    test = {"test": {"frames": "4:6", "cameras": ["c7"]}, "validation": {"frames": "2:3", "cameras": ["c1"]}}
    bare = {"test": {"frames": "1:2", "cameras": []}, "validation": {"frames": "0:1", "cameras": ["f1"]}}
    found["splits"] = {"face": bare, "body": test}
    return {**found, "commands": ["avatarrex-studio train x"], "test": {"body": body, "face": part, "face_alone": part}}


def test_figures_are_there(tool: ModuleType) -> None:
    assert {path.stem for path in FILES} == set(tool.SUBJECTS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_tables_are_those_of_the_figures(path: Path, tool: ModuleType) -> None:
    page = (ROOT / "docs" / "results.md").read_text()
    assert tool.written(page, path.stem, tool.tables(json.loads(path.read_text()))) == page


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_figures_are_by_the_commands_of_now(path: Path, tool: ModuleType) -> None:
    name, subject = path.stem, tool.SUBJECTS[path.stem]
    steps = (*tool.training(name, subject).values(), *tool.evaluations(name, subject).values())
    assert json.loads(path.read_text())["commands"] == [step.command for step in steps]


def test_a_table_has_a_row_for_each_subject_and_its_surface(tool: ModuleType) -> None:
    text = tool.tables(figures())
    assert "commit abc1234, seed 5, 25 minutes of the wall" in text
    body, face = (
        "test frames 4:6 and cameras c7, validation frames 2:3",
        "test frames 1:2 and cameras none, validation frames 0:1",
    )
    assert (
        f"Kept from training: body rig, {body}; face rig, {face} (A:B is without B; capture key 0123456789abcdef)."
        in text
    )
    assert "| pose | 3 | avatar | **20.00** | 20.00 | 20.000 | 20.000 | 20.000 | 20.000 | 20.00 | 1.3 / 4.0 |" in text
    assert "| pose and camera | 1 | avatar | **16.00** | 20.000 | 20.000 | 20.000 | 20.00 |\n" in text


def test_regions_are_a_table_where_they_were_measured(tool: ModuleType) -> None:
    found = figures()
    assert (
        "| eyes: PSNR | SSIM | sharpness |\n| --- | --- | --- | --- |\n| avatar | 26.16 | 0.801 | 0.80 |"
        in tool.tables(found)
    )
    assert "eyes" not in tool.tables(found | {"regions": None})


def test_margins_are_over_the_mesh_that_each_part_has(tool: ModuleType) -> None:
    text = tool.tables(figures())
    assert "| fitted mesh, own face | +3.00 | −1.00 | +3.00 | +3.00 | +3.00 | +3.00 |" in text
    assert "| fitted textured mesh, of the face fine texels | +1.00 | −2.50 | +2.00 | +2.00 | +2.00 | +2.00 |" in text
    assert "avatar 4.00 dB, fitted textured mesh 0.50 dB." in text


def test_a_page_without_marks_is_refused(tool: ModuleType) -> None:
    with pytest.raises(ValueError, match=r"<!-- figures other -->"):
        tool.written("no marks", "other", "text")


@pytest.fixture
def runs(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Commands that would have been run; those of trainings make their folders, all others a file."""
    found: list[str] = []

    def run(words: list[str], *, cwd: Path, **_: Any) -> None:
        line = " ".join(words)
        found.append(line)
        out = cwd / (line.split("--out ")[1].split()[0] if "--out" in words else words[-1])
        if "--out" in words:
            out.mkdir(parents=True, exist_ok=True)
            out /= "run.json"
        out.write_text("{}")

    monkeypatch.setattr(tool.subprocess, "run", run)
    monkeypatch.setattr(tool, "head", lambda: "abc1234")
    return found


def test_a_step_is_done_again_where_its_command_is_another(tool: ModuleType, runs: list[str], tmp_path: Path) -> None:
    (tmp_path / "here.json").touch()
    for command in ("cp one here.json", "cp one here.json", "cp another here.json"):
        tool.Step(command, "here.json").run(tmp_path)
    assert runs == ["cp one here.json", "cp another here.json"]


def test_a_training_that_was_ended_goes_on(tool: ModuleType, runs: list[str], tmp_path: Path) -> None:
    name, subject = "person_m002", tool.SUBJECTS["person_m002"]
    run = tmp_path / "runs" / name
    run.mkdir(parents=True)
    (run / "run.json").touch()
    (tmp_path / f"{name}_body.json").touch()
    tool.train(name, subject, tmp_path)
    assert runs[0].endswith("--out runs/person_m002 --resume")
    assert (tmp_path / f"{name}_body.json").exists()


def test_a_new_training_lets_go_of_the_figures_of_the_one_before(
    tool: ModuleType, runs: list[str], tmp_path: Path
) -> None:
    name, subject = "person_m002", tool.SUBJECTS["person_m002"]
    (tmp_path / f"{name}_body.json").touch()
    tool.train(name, subject, tmp_path)
    assert runs[0].endswith("--out runs/person_m002")
    assert not (tmp_path / f"{name}_body.json").exists()
    assert json.loads((tmp_path / f"{name}_training.json").read_text())["commit"] == "abc1234"
    tool.train(name, subject, tmp_path)
    assert len(runs) == 2  # training and copy, once each
