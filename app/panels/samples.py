"""Samples: what a run renders beside the picture it should be, and where the two differ.

The difference is the mean over the channels of |render − truth|, sRGB-encoded in [0, 1], times a gain, from black over
violet and orange to white.
"""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
from avatarrex_studio.jobs.run_view import RunView
from avatarrex_studio.jobs.watcher import Watcher
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.texture import uploaded
from imgui_bundle import imgui, imgui_ctx
from jaxtyping import UInt8

HEAT = np.array([(0, 0, 0), (70, 20, 110), (190, 55, 85), (245, 145, 35), (255, 250, 220)], np.float64)
ROWS = 3
"""Runs that are shown below one another."""
TITLES = {"truth": "Ground truth", "render": "Avatar", "difference": "Difference"}
GAP = 8.0
HIGHEST = 400.0
"""Points that a picture may be high."""


class Samples:
    """The pictures of one view, for every run that is compared."""

    def __init__(self) -> None:
        self.view, self.gain = "", 4.0
        self.step: int | None = None
        """The step that is looked at; None follows the newest."""
        self._wanted: dict[str, tuple[object, UInt8[np.ndarray, "h w 3"]]] = {}
        self._textures: dict[str, tuple[object, moderngl.Texture]] = {}

    def draw(self, runs: Sequence[tuple[RunView, theme.Rgb]], watcher: Watcher, part: str) -> None:
        """Draw the newest pictures of `runs`, each with its colour, of the views that belong to `part`."""
        names = sorted({name for run, _ in runs for name in run.samples if not part or name.startswith(f"{part}/")})
        self._wanted = {}
        if not names:
            widgets.caption("No sample pictures yet")
            return
        if self.view not in names:
            self.view, self.step = names[0], None
        having = [(run, colour) for run, colour in runs if self.view in run.samples][:ROWS]
        newest = self._options(names, having)
        width = widgets.room()
        highest = HIGHEST if len(having) == 1 else 0.6 * HIGHEST
        used = 0.0
        for run, colour in having:
            with imgui_ctx.begin_group():
                if len(having) > 1:
                    widgets.caption(run.name, colour)
                self._row(run, watcher, newest if self.step is None else self.step, width, highest)
            row = imgui.get_item_rect_size().x + 3 * GAP
            used += row
            if run is not having[-1][0] and used + row < width:
                imgui.same_line(0, 3 * GAP)
            else:
                used = 0.0

    def upload(self, context: moderngl.Context) -> None:
        """Bring what was drawn into textures. Before the interface's frame, in the window's context."""
        for slot, (version, pixels) in self._wanted.items():
            known, texture = self._textures.get(slot, (None, None))
            if known != version:
                self._textures[slot] = version, uploaded(context, pixels, texture)

    def close(self) -> None:
        """Give the textures back."""
        for _, texture in self._textures.values():
            texture.release()
        self._textures.clear()

    def _options(self, names: Sequence[str], having: Sequence[tuple[RunView, object]]) -> int:
        """View, step and gain; the newest step there is."""
        rendered = [at for run, _ in having for kind, at in run.samples[self.view].items() if kind != "truth"]
        steps = sorted({step for at in rendered for step in at} or {0})
        wide = 0.36 * widgets.room()
        imgui.set_next_item_width(min(200.0, wide))
        picked = widgets.choice("##view", names, self.view.partition("/")[2] or self.view, self.view)
        if picked:
            self.view, self.step = picked, None
        imgui.same_line()
        at = len(steps) - 1 if self.step is None else min(int(np.searchsorted(steps, self.step)), len(steps) - 1)
        imgui.set_next_item_width(min(260.0, wide))
        moved, at = imgui.slider_int("##step", at, 0, len(steps) - 1, f"step {steps[at]:,}")
        if moved:
            self.step = None if at == len(steps) - 1 else steps[at]
        imgui.same_line()
        imgui.set_next_item_width(min(110.0, widgets.room()))
        _, self.gain = imgui.slider_float("##gain", self.gain, 1.0, 16.0, "diff × %.0f")
        return steps[-1]

    def _row(self, run: RunView, watcher: Watcher, step: int, width: float, highest: float) -> None:
        kinds = dict.fromkeys([*TITLES, *run.samples[self.view]])
        paths = {kind: path for kind in kinds if (path := run.picture(self.view, kind, step))}
        pictures = {kind: watcher.picture(path) for kind, path in paths.items()}
        shown = {kind: pixels for kind, pixels in pictures.items() if pixels is not None}
        truth, render = shown.get("truth"), shown.get("render")
        if truth is not None and render is not None and truth.shape == render.shape:
            shown["difference"] = difference(truth, render, self.gain)
        side = (width - GAP * (len(kinds) - 1)) / len(kinds)
        if shown:
            side = min(side, min(highest * pixels.shape[1] / pixels.shape[0] for pixels in shown.values()))
        versions = {**paths, "difference": (paths.get("truth"), paths.get("render"), self.gain)}
        for kind in widgets.in_rows(kinds, GAP):
            with imgui_ctx.begin_group():
                widgets.caption(TITLES.get(kind, kind))
                self._picture(f"{run.path}:{kind}", versions.get(kind), shown.get(kind), side)

    def _picture(self, slot: str, version: object, pixels: UInt8[np.ndarray, "h w 3"] | None, side: float) -> None:
        """One picture `side` points wide, as far as it is there."""
        if pixels is not None:
            self._wanted[slot] = version, pixels
        _, texture = self._textures.get(slot, (None, None))
        width, height = pixels.shape[1::-1] if pixels is not None else texture.size if texture else (1, 1)
        size = (side, side * height / width)
        if texture is None:
            imgui.dummy(size)
        else:
            imgui.image(imgui.ImTextureRef(texture.glo), size)


def difference(truth: UInt8[np.ndarray, "h w 3"], render: UInt8[np.ndarray, "h w 3"], gain: float
               ) -> UInt8[np.ndarray, "h w 3"]:  # fmt: skip
    """Where and how much two pictures differ, as heat."""
    amount = gain * np.abs(truth.astype(np.float64) - render).mean(-1) / 255
    place = np.clip(amount, 0, 1) * (len(HEAT) - 1)
    knots = np.arange(len(HEAT))
    return np.stack([np.interp(place, knots, HEAT[:, channel]) for channel in range(3)], -1).round().astype(np.uint8)
