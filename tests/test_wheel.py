"""The wheel: three packages with their data and nothing else, and it renders away from the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
PACKAGES = {"avatarrex": "avatarrex", "app": "avatarrex_studio", "shaders": "avatarrex_shaders"}
"""Folder of the checkout -> what it is installed as."""
SOURCES = (*PACKAGES, "assets_spec", "pyproject.toml", "README.md", "LICENSE", "NOTICE")


def expected() -> set[str]:
    """Every file of the three folders under its installed name."""
    names = set()
    for folder, package in PACKAGES.items():
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                names.add(str(Path(package) / path.relative_to(ROOT / folder)))
    return names | {f"avatarrex/assets_spec/{path.name}" for path in (ROOT / "assets_spec").iterdir()}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, so that no `build/` appears in the checkout."""
    copy, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy(ROOT / name, copy / name)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(out),
        ".",
    ]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (path,) = out.iterdir()
    return path


def test_three_packages_and_all_their_files(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert {name.split("/")[0] for name in names} == set(PACKAGES.values())
    assert expected() - names == set(), "a package or a kind of data file is missing in pyproject.toml"
    assert names - expected() == set()


@pytest.mark.slow
def test_it_renders_away_from_the_checkout(wheel, tmp_path):
    """Unpacked beside the dependencies of this environment; nothing of the checkout is on the path."""
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    for compiled in (ROOT / "avatarrex").rglob(
        "__pycache__/*.nb?"
    ):  # a quarter of a minute; numba takes those of the same sources
        folder = site / compiled.parent.relative_to(ROOT)
        folder.mkdir(exist_ok=True)
        shutil.copy(compiled, folder)
    code = """
import sys
sys.path[:0] = sys.argv[1:3]  # the wheel, then the dependencies
import avatarrex, avatarrex_studio, avatarrex_shaders
for package in (avatarrex, avatarrex_studio, avatarrex_shaders):
    assert package.__path__[0].startswith(sys.argv[1]), package.__path__
from avatarrex_studio.cli.main import main
sys.exit(main(["render", "out.png", "--pose", "stand", "--size", "64"]))
"""
    dependencies = sysconfig.get_path("purelib")
    # -S: no site-packages, hence no editable install that leads back to the checkout
    command = [sys.executable, "-S", "-c", code, str(site), dependencies]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "out.png") as image:
        assert image.size == (64, 64)
        assert len(image.convert("RGB").getcolors(4096)) > 200, "a person, not a background"
