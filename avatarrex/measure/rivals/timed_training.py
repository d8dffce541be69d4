"""Training of a rival for so much processor time, in an ordinary run: stopped, killed and resumed as others are.

Adam at a rate that falls by half a cosine to `LAST` of its first value; batches depend on seed and step alone.
"""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import torch

from avatarrex.errors import InputError
from avatarrex.measure.rivals.rival import Rival
from avatarrex.training.core.work import load
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.folder import Run

LAST = 0.02
SAVE = 60.0
"""Seconds of processor time between checkpoints."""
REPORT = 50
"""Steps between reported losses."""
WAIT = 0.5
"""Seconds between looks at a paused run's wish."""


def train(rival: Rival, run: Run, seconds: float, seed: int) -> bool:
    """Steps until `seconds` of processor time have gone into them, from the run's last checkpoint; False where it was stopped."""
    torch.manual_seed(seed)
    optimiser = torch.optim.Adam(rival.parameters(), rival.rate)
    used, step = resume(rival, run, optimiser)
    saved = used
    while used < seconds:
        while (wish := run.control()) == "pause":
            time.sleep(WAIT)
        if wish == "stop":
            break
        begun = time.process_time()
        progress = used / seconds
        rate = rival.rate * (LAST + (1 - LAST) * 0.5 * (1 + math.cos(math.pi * progress)))
        optimiser.param_groups[0]["lr"] = rate
        optimiser.zero_grad(set_to_none=True)
        loss = rival.loss(np.random.default_rng((seed, step)), progress)
        loss.backward()
        optimiser.step()
        step += 1
        used += time.process_time() - begun
        if step % REPORT == 0:
            run.scalars(step, {f"{run.part}/loss/total": loss.item(), f"{run.part}/schedule/lr": rate})
        if used - saved > SAVE:
            saved = used
            save(rival, run, optimiser, used, step)
    save(rival, run, optimiser, used, step)
    return used >= seconds


def save(rival: Rival, run: Run, optimiser: torch.optim.Adam, used: float, step: int) -> None:
    """A checkpoint."""
    run.save(step, {"networks": rival.state_dict(), "optimiser": optimiser.state_dict(), "seconds": used})


def resume(rival: Rival, run: Run, optimiser: torch.optim.Adam) -> tuple[float, int]:
    """Seconds used and steps of the last checkpoint, which is loaded; none of a new run."""
    if (found := run.latest()) is None:
        return 0.0, 0
    step, state = found
    rival.load_state_dict(state["networks"])
    load(optimiser, state["optimiser"])
    return float(state["seconds"]), step


def read(rival: Rival, folder: Path) -> int:
    """Load what a run has learnt, and say in how many steps. Raises `InputError` where it has no checkpoint that is whole."""
    found = checkpoint.newest(folder / "checkpoints")
    if found is None:
        raise InputError(folder, "checkpoints", "one that is whole", "none")
    rival.load_state_dict(found[1]["networks"])
    return found[0].manifest.step
