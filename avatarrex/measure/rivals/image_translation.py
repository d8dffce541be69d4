"""Image translation: a U-Net turns the picture of the fitted textured mesh into a photograph (after SMPLpix, Prokudin et al. 2021).

What it is shown of a pixel is what the mesh has there: colours of the finest texels that the cameras resolve, coverage, depth before
the mean depth of the mesh, normals in the camera's frame and in that in which the light is fixed. What it gives is added to those
colours and that coverage, so that untrained it is the mesh. Letters: h w pixels, b batch, c channels. Colours sRGB-encoded in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import l1_loss, pad

from avatarrex.camera import Camera
from avatarrex.capture.readers.rigs import Rig
from avatarrex.fields.unet import UNet
from avatarrex.measure.rivals.rival import Rival
from avatarrex.metrics.baselines import MeshDrawer
from avatarrex.metrics.drawing import Drawing, over_black
from avatarrex.metrics.perceptual import Perceptual
from avatarrex.ops.rotation import matrix_from_rotvec
from avatarrex.signals.driving import Signals
from avatarrex.training.core.pixels import training_pairs

CHANNELS = 11
"""Three of colour, coverage, depth, three each of the normal in two frames."""
LEVELS = (16, 32, 64, 96, 128)
CROP, BATCH = 128, 4
MARGIN = 24
"""Pixels about the mesh in which it may be wrong."""
KEPT_PIXELS = 100_000_000
"""Of pictures whose examples are kept, a gigabyte where a person fills a third of them; others are drawn anew."""
MATTE, PERCEPTUAL = 0.5, 0.1
"""Weights of the coverage's error and of the perceptual term, beside that of colours."""


@dataclass(frozen=True, eq=False)
class Example:
    """One picture of the training, cut to the mesh and its margin."""

    shown: Float[Tensor, "c h w"]
    truth: Float[Tensor, "4 h w"]
    """Premultiplied colour, matte."""


class ImageTranslation(Rival):
    """Beside `mesh`, from the pictures of `rig` that a training reads; the light is fixed in the `world` or in the `root` frame."""

    name, rate = "image translation", 1e-3

    def __init__(self, mesh: MeshDrawer, rig: Rig, light_frame: str) -> None:
        super().__init__()
        self._mesh, self._rig, self._pairs, self._light_frame = mesh, rig, training_pairs(rig), light_frame
        largest = max(rig.views[view].camera.width * rig.views[view].camera.height for _, view in self._pairs)
        self._example = lru_cache(max(KEPT_PIXELS // largest, BATCH))(partial(example, mesh, rig, light_frame))
        self._perceptual = (Perceptual.load(),)  # in a tuple: no module of ours
        self.network = UNet(CHANNELS, LEVELS, 4)
        for values in self.network.out.parameters():
            torch.nn.init.zeros_(values)

    def loss(self, rng: np.random.Generator, progress: float) -> Float[Tensor, ""]:
        """Absolute errors of premultiplied colour and coverage, and the perceptual term of pass II, of crops of one picture each."""
        crops = [self._crop(rng) for _ in range(BATCH)]
        drawn = self(torch.stack([crop.shown for crop in crops]))
        truth = torch.stack([crop.truth for crop in crops])
        unlike = self._perceptual[0].distance(drawn[:, :3], truth[:, :3]).mean()
        colour, matte = (l1_loss(drawn[:, part], truth[:, part]) for part in (slice(3), 3))
        return colour + MATTE * matte + PERCEPTUAL * unlike

    def forward(self, shown: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 4 h w"]:
        """Premultiplied colour and coverage, not clamped: errors beyond 0 and 1 have slopes, too. h and w of any size."""
        height, width = shown.shape[2:]
        step = 2 ** (len(LEVELS) - 1)
        added = self.network(pad(shown, (0, -width % step, 0, -height % step)))[:, :, :height, :width]
        coverage = shown[:, 3:4] + added[:, 3:]
        return torch.cat([coverage * (shown[:, :3] + added[:, :3]), coverage], 1)

    @torch.no_grad()
    def draw(self, signals: Signals, camera: Camera) -> Drawing:
        """The translated picture; surface of the mesh."""
        drawn = self._mesh.draw(signals, camera)
        image = self(self._shown(drawn, signals, camera)[None])[0].permute(1, 2, 0).clamp(0, 1).contiguous()
        return Drawing(image, drawn.position, drawn.normal, drawn.hit)

    def _crop(self, rng: np.random.Generator) -> Example:
        """`CROP`² pixels about any pixel of an example; black where they reach beyond it."""
        example = self._example(*self._pairs[rng.integers(len(self._pairs))])
        height, width = example.truth.shape[1:]
        y, x = (int(rng.integers(side)) - CROP // 2 for side in (height, width))
        cut = np.s_[:, max(y, 0) : y + CROP, max(x, 0) : x + CROP]
        fill = (max(-x, 0), max(x + CROP - width, 0), max(-y, 0), max(y + CROP - height, 0))
        return Example(pad(example.shown[cut].float(), fill), pad(example.truth[cut].float(), fill))

    def _shown(self, drawn: Drawing, signals: Signals, camera: Camera) -> Float[Tensor, "c h w"]:
        return shown(drawn, camera, light_from_world(self._light_frame, signals))


def example(mesh: MeshDrawer, rig: Rig, light_frame: str, frame: int, view: int) -> Example:
    """In half precision."""
    signals, camera = rig.signals[frame], rig.views[view].camera
    truth = over_black(rig.image(view, frame), rig.matte(view, frame), camera.width, camera.height)
    shows = shown(mesh.draw(signals, camera), camera, light_from_world(light_frame, signals))
    layers = torch.cat([truth.image, truth.matte[..., None]], -1).permute(2, 0, 1)
    y, x = (_span(shows[3].amax(axis) > 0) for axis in (1, 0))
    return Example(shows[:, y, x].half(), layers[:, y, x].half())


def shown(drawn: Drawing, camera: Camera, light_turn: Float[np.ndarray, "3 3"]) -> Float[Tensor, "c h w"]:
    """What the U-Net sees of a mesh: straight colour, coverage, metres before the mesh's mean depth, normals in both frames."""
    image, hit = drawn.image, torch.from_numpy(drawn.hit)
    rotation, offset = camera.camera_from_world[:3, :3], camera.camera_from_world[2, 3]
    depth = torch.from_numpy(drawn.position @ rotation[2] + offset).float()
    middle = depth[hit].mean() if hit.any() else depth.new_zeros(())
    normals = [torch.from_numpy(drawn.normal @ turn.T).float() for turn in (rotation, light_turn)]
    colour = image[..., :3] / image[..., 3:].clamp_min(1e-6)
    layers = [colour, image[..., 3:], torch.where(hit, middle - depth, 0)[..., None], *normals]
    return torch.cat(layers, -1).permute(2, 0, 1).contiguous()


def light_from_world(light_frame: str, signals: Signals) -> Float[np.ndarray, "3 3"]:
    """The turn into the frame in which the light is fixed, `world` or `root`."""
    if light_frame == "world":
        return np.eye(3)
    turn: np.ndarray = matrix_from_rotvec(torch.from_numpy(np.array(signals.global_orient, np.float64))).numpy().T
    return turn


def _span(covered: Tensor) -> slice:
    """From the first to the last that is covered, with the margin; everything where none is."""
    (places,) = torch.nonzero(covered, as_tuple=True)
    if not len(places):
        return slice(None)
    return slice(max(int(places[0]) - MARGIN, 0), int(places[-1]) + MARGIN + 1)
