"""The pictures of an export: rendered at the order's raster and level, with label and mark. Letters: h w image rows and columns."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from avatarrex_studio.engine.engine import Engine
from avatarrex_studio.engine.passes import passes
from avatarrex_studio.engine.staging import in_light, over_stage, together
from avatarrex_studio.jobs.export_look import Look
from avatarrex_studio.session.state import Colour, StudioState
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn.functional import avg_pool2d

from avatarrex.files.exr import write_exr
from avatarrex.files.images import write_jpeg, write_png
from avatarrex.files.watermark import mark
from avatarrex.frame import Frame
from avatarrex.stage.lighting import Lit
from avatarrex.stage.stage import COLOUR, Stage

CLEAR: Colour = (0.0, 0.0, 0.0, 0.0)
LABEL_SHARE, LEAST_LABEL = 1 / 36, 11
"""Height of the label's letters: a share of the picture's shorter side, pixels at least."""


class Drawer:
    """Draws states as one order wants them."""

    def __init__(self, engine: Engine, look: Look) -> None:
        self._engine, self._look = engine, look

    def pixels(self, state: StudioState) -> UInt8[np.ndarray, "h w 4"]:
        """Straight-alpha bytes of a state."""
        look, state = self._look, self._shown(state)
        seen = in_light(self._frames(state), state)
        pixels = over_stage(Lit(averaged(seen.image, look.samples), seen.floor), state)
        if look.marked:
            pixels = mark(pixels)
        return labelled(pixels, look.label) if look.label else pixels

    def write_picture(self, path: Path, state: StudioState) -> None:
        """A PNG or JPEG with the state in it."""
        pixels, text = self.pixels(state), json.dumps(self._shown(state).to_json())
        if path.suffix.lower() == ".png":
            write_png(path, pixels, {"avatarrex": text})
        else:
            write_jpeg(path, pixels, text)

    def write_layers(self, path: Path, state: StudioState, names: tuple[str, ...]) -> None:
        """An OpenEXR file: colour averaged over the samples, passes of the sample nearest each pixel's middle."""
        frames, samples = self._frames(state), self._look.samples
        image = averaged(together(frames, [frame.image for frame in frames]), samples).double().cpu().numpy()
        middle = slice(samples // 2, None, samples)
        made = passes(frames, names)
        layers = {LAYER[name]: values[middle, middle] for name, values in made.items() if name in LAYER}
        write_exr(path, image, layers, {"avatarrex": json.dumps(self._shown(state).to_json())})

    def _shown(self, state: StudioState) -> StudioState:
        """The state that the file is of: at its level and raster."""
        stage = state.stage if self._look.stage else Stage()
        if not self._look.clear:
            return state.change(level=self._look.level, stage=stage)
        return state.change(level=self._look.level, background=CLEAR, stage=replace(stage, backdrop=COLOUR))

    def _frames(self, state: StudioState) -> tuple[Frame, ...]:
        width, height = (side * self._look.samples for side in self._look.size)
        return self._engine.frames(self._shown(state), state.view.camera(width, height))


LAYER = {"depth": "Z", "normal": "N", "position": "P"}
"""Names of passes as compositing programs know them."""


def averaged(image: Float[Tensor, "h w 4"], samples: int) -> Float[Tensor, "a b 4"]:
    """The mean of each square of `samples`² premultiplied pixels."""
    if samples == 1:
        return image
    return avg_pool2d(image.movedim(-1, 0)[None], samples)[0].movedim(0, -1)


def labelled(pixels: UInt8[np.ndarray, "h w 4"], text: str) -> UInt8[np.ndarray, "h w 4"]:
    """The picture with `text` at its lower right, light on a dark shadow."""
    height, width = pixels.shape[:2]
    size = max(LEAST_LABEL, round(LABEL_SHARE * min(width, height)))
    font = ImageFont.load_default(size)
    layer = Image.new("RGBA", (width, height))
    draw, place = ImageDraw.Draw(layer), (width - 0.7 * size, height - 0.7 * size)
    draw.text((place[0] + 1, place[1] + 1), text, (0, 0, 0, 160), font, "rs")
    draw.text(place, text, (255, 255, 255, 215), font, "rs")
    return np.asarray(Image.alpha_composite(Image.fromarray(pixels), layer)).copy()
