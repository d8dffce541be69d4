"""A small real training for tests of run folders and viewers: a coordinate network learns one picture.

    python tests/tiny_run.py OUT [--steps N] [--every N] [--seconds S] [--resume] [--target FILE.png]

It resumes bit for bit, obeys pause and stop, and ends on Ctrl+C with a checkpoint, as a training does.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from avatarrex.avatar import Avatar
from avatarrex.training.runs.folder import Run


class Picture(torch.nn.Module):
    """Colour by place: Fourier features and two layers."""

    def __init__(self, width=32):
        super().__init__()
        self.register_buffer("waves", torch.randn(2, 16, generator=torch.Generator().manual_seed(5)) * 4)
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(32, width), torch.nn.ReLU(), torch.nn.Linear(width, 3), torch.nn.Sigmoid()
        )

    def forward(self, place):
        phase = place @ self.waves
        return self.layers(torch.cat([phase.sin(), phase.cos()], -1))


def target(path=None):
    """(h, w, 3) in [0, 1]: a picture file, or a disc on a gradient."""
    if path:
        return torch.from_numpy(np.array(Image.open(path).convert("RGB"))).float() / 255
    y, x = torch.meshgrid(torch.linspace(-1, 1, 48), torch.linspace(-1, 1, 36), indexing="ij")
    disc = ((x**2 + y**2) < 0.4).float()
    return torch.stack([disc, 0.5 + 0.5 * y, 0.5 + 0.5 * x * (1 - disc)], -1)


def fit(out, steps=40, every=5, seconds=0.0, rate=1e-2, picture=None, avatar=None):
    """Train from the start, or from the newest checkpoint; a checkpoint `step_n` has the state after n steps."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    resume = (Path(out) / "run.json").exists()
    config = {"part": "body", "preset": "smoke", "capture": "a picture", "seed": 0, "steps": steps, "rate": rate}
    model, truth = Picture(), target(picture)
    height, width = truth.shape[:2]
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    places, colours = torch.stack([x, y], -1).reshape(-1, 2), truth.reshape(-1, 3)
    optimiser = torch.optim.Adam(model.parameters(), lr=rate)
    draw = np.random.default_rng(0)
    with Run.open(out) if resume else Run.create(out, config) as run:
        first, found = 0, run.latest()
        if found:
            first, state = found
            model.load_state_dict(state["model"])
            optimiser.load_state_dict(state["optimiser"])
            draw.bit_generator.state = state["draw"]
            torch.set_rng_state(state["rng"])
        run.stage("body", "I", steps)

        def save(step):
            state = {"model": model.state_dict(), "optimiser": optimiser.state_dict(),
                     "draw": draw.bit_generator.state, "rng": torch.get_rng_state()}  # fmt: skip
            with torch.no_grad():
                image = model(places)
            psnr = float(-10 * (image - colours).square().mean().log10())
            run.scalars(step, {"body/heldout/psnr": psnr, "body/heldout/ssim": 1 - 1 / max(psnr, 1)})
            for name, pixels in (("truth", colours), ("render", image)):
                pixels = (255 * pixels.reshape(height, width, 3)).round().byte().numpy()
                run.picture(step, f"body/disc/{name}", pixels)
            run.save(step, state, avatar=avatar, score=psnr)

        step, saved = first, first
        try:
            for step in range(first, steps):
                while run.control() == "pause":
                    time.sleep(0.02)
                if run.control() == "stop":
                    break
                chosen = torch.from_numpy(draw.integers(0, len(places), 256))
                noise = 1e-3 * torch.randn(256, 3)
                error = model(places[chosen]) - colours[chosen] - noise
                rgb, size = error.square().mean(), 1e-4 * sum(p.square().sum() for p in model.parameters())
                optimiser.zero_grad()
                (rgb + size).backward()
                optimiser.step()
                time.sleep(seconds)
                run.scalars(
                    step,
                    {"body/loss/total": (rgb + size).item(), "body/loss/rgb": rgb.item(), "body/loss/size": size.item(),
                     "body/schedule/lr": rate, "body/schedule/gamma": 10 * 1.01**step, "body/memory/mib": 300.0},
                )  # fmt: skip
                if (step + 1) % every == 0:
                    saved = step + 1
                    save(saved)
        finally:
            if run.control() == "stop" and step > saved:
                save(step)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("words", nargs="*", help="OUT, or `train CAPTURE --out OUT` as the studio starts it")
    parser.add_argument("--out")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.0)
    parser.add_argument("--rate", type=float, default=1e-2)
    parser.add_argument("--target")
    parser.add_argument("--recipe", "--preset")
    parser.add_argument("--parts")
    parser.add_argument("--avatar", action="store_true", help="keep an untrained avatar beside every checkpoint")
    parser.add_argument("--resume", action="store_true")
    given = parser.parse_args()
    kept = None
    if given.avatar:
        from avatarrex.templates.person import load_person

        kept = Avatar.create(load_person("default"), "compact")
    fit(given.out or given.words[-1], given.steps, given.every, given.seconds, given.rate, given.target, kept)
