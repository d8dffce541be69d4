"""What this machine has of what the studio can use, and the next step for what is missing: the window's page and `inspect` print it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from avatarrex.gl.context import NoContext, gl_context, in_software, renderer_name
from avatarrex.templates.official.known_models import KNOWN, KnownModel, models_folder

PACKAGES: tuple[tuple[str, str, str, str], ...] = (
    ("Videos", "av", "MP4 and WebM in Export…, films of captures (PyAV has its own ffmpeg)", "video"),
    ("Layers", "OpenEXR", "OpenEXR in Export…", "exr"),
    ("USD", "pxr", "USD in Export…", "usd"),
    ("FBX", "bpy", "motions in .fbx (Blender as a Python module)", "fbx"),
    ("Webcam", "mediapipe", "a webcam that drives the face", "webcam"),
    ("Virtual camera", "pyvirtualcam", "the picture as the camera of a video call", "camera"),
)
"""Title, module, what it gives, and the extra that installs it."""
DISTRIBUTIONS = {"pxr": "usd-core"}
"""Of modules with another name."""


@dataclass(frozen=True)
class Ability:
    """One thing that the studio can use."""

    name: str
    there: bool
    words: str
    """What was found; what is missing, and what goes on without it."""
    next_step: str = ""
    """What to do for more."""


def available() -> tuple[Ability, ...]:
    """All, in the order of the page. Torch and an OpenGL context are taken for it."""
    packages = (_package(*entry) for entry in PACKAGES)
    return (_opengl(), _graphics_card(), *packages, *_cameras(), *models(models_folder()))


def models(folder: Path) -> tuple[Ability, ...]:
    """The models that a user may bring; their files are not opened."""
    return tuple(_model(model, folder) for model in KNOWN)


def _model(model: KnownModel, folder: Path) -> Ability:
    path = model.find(folder)
    if path is not None:
        return Ability(model.title, True, path.name)
    step = f"Get {model.files[0]} from {model.published}; then: avatarrex-studio models add {model.files[0]}"
    return Ability(model.title, False, f"no {model.files[0]}: without it {model.without}", step)


def lines(found: tuple[Ability, ...]) -> list[str]:
    """As text: a line for each, and one for its next step."""
    written = []
    for entry in found:
        written.append(f"{'yes' if entry.there else 'no ':3}  {entry.name}: {entry.words}")
        written += [f"       {entry.next_step}"] if entry.next_step else []
    return written


def _opengl() -> Ability:
    try:
        context = gl_context()
    except NoContext as error:
        return Ability(
            "OpenGL 4.3",
            False,
            f"none ({error}); rays are cast by torch, no surface is drawn",
            "Install a driver of the graphics card, or Mesa.",
        )
    name = renderer_name(context)
    if in_software(name):
        return Ability(
            "OpenGL 4.3",
            True,
            f"{name}: in software, which is slow in large windows",
            "With a graphics card: install its driver.",
        )
    return Ability("OpenGL 4.3", True, name)


def _graphics_card() -> Ability:
    import torch

    if torch.cuda.is_available():
        return Ability("GPU for networks", True, f"{torch.cuda.get_device_name()}; start with --device cuda to use it")
    wheel = torch.version.cuda
    why = "no CUDA device answers" if wheel else "this torch is made for processors"
    return Ability(
        "GPU for networks", False, f"{why}; exact pictures and training run on the processor, the surface does not need one",
        "With an NVIDIA card: its driver, and a torch with CUDA (pytorch.org).",
    )  # fmt: skip


def _package(name: str, module: str, gives: str, extra: str) -> Ability:
    if find_spec(module) is None:
        return Ability(name, False, f"no {module}: {gives}, is left out", f"pip install 'avatarrex-studio[{extra}]'")
    try:
        found = version(DISTRIBUTIONS.get(module, module))
    except PackageNotFoundError:
        found = "installed"
    step = (
        "Its model is a file that you name: face_landmarker.task, from ai.google.dev/edge/mediapipe."
        if extra == "webcam"
        else ""
    )
    return Ability(name, True, f"{module} {found}: {gives}", step)


def _cameras() -> tuple[Ability, ...]:
    """Where the system says by a file which cameras it has."""
    if not sys.platform.startswith("linux"):
        return ()
    films = sorted(Path("/dev").glob("video*"))
    camera = Ability("Camera", True, ", ".join(map(str, films)))
    if not films:
        step = "Plug one in, and be in the group 'video'."
        camera = Ability("Camera", False, "no /dev/video*: a film drives the face as well", step)
    loop = Ability("Loopback", True, "v4l2loopback: the virtual camera has a device")
    if not Path("/sys/module/v4l2loopback").exists():
        step = "sudo apt-get install v4l2loopback-dkms; sudo modprobe v4l2loopback"
        loop = Ability("Loopback", False, "no v4l2loopback: the virtual camera has no device", step)
    return camera, loop
