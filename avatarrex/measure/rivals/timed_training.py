"""Training of a rival for so much processor time, in an ordinary run: stopped, killed and resumed, but not bit for bit.

Adam at a rate that falls by half a cosine to `LAST` of its first value; batches depend on seed and step alone.
"""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import torch

from avatarrex.errors import InputError, check
from avatarrex.measure.rivals.rival import Rival
from avatarrex.training.core.work import load
from avatarrex.training.runs import checkpoint
from avatarrex.training.runs.folder import Run
from avatarrex.training.runs.interruption import Interruption

LAST = 0.02
SAVE = 60.0
"""Seconds of processor time between checkpoints."""
REPORT = 50
"""Steps between reported losses."""
WAIT = 0.5
"""Seconds between looks at a paused run's wish."""


def train(rival: Rival, run: Run, seconds: float, seed: int) -> bool:
    """Steps until `seconds` of processor time have gone into them, from the run's last checkpoint; False where it was stopped.

    Raises `InputError` for no time, and for a loss that is no number.
    """
    check(seconds > 0, run.path, "processor seconds", "more than 0", seconds)
    torch.manual_seed(seed)
    optimiser = torch.optim.Adam(rival.parameters(), rival.rate)
    used, step = resume(rival, run, optimiser)
    saved, interruption = used, Interruption()
    with interruption.handled():
        while used < seconds and not _stopped(run, interruption):
            begun = time.process_time()
            rate = rival.rate * (LAST + (1 - LAST) * 0.5 * (1 + math.cos(math.pi * used / seconds)))
            value = _descend(rival, optimiser, rate, rival.loss(np.random.default_rng((seed, step)), used / seconds))
            step += 1
            used += time.process_time() - begun
            check(math.isfinite(value), run.path, f"loss of step {step}", "a finite number", value)
            if step % REPORT == 0:
                run.scalars(step, {f"{run.part}/loss/total": value, f"{run.part}/schedule/lr": rate})
            if used - saved > SAVE:
                saved = used
                save(rival, run, optimiser, used, step)
    save(rival, run, optimiser, used, step)
    return used >= seconds


def _stopped(run: Run, interruption: Interruption) -> bool:
    """Whether Ctrl+C or the run's control.json requests a stop; waits while it requests a pause."""
    while (wish := run.control()) == "pause" and not interruption.requested:
        time.sleep(WAIT)
    return interruption.requested or wish == "stop"


def _descend(rival: Rival, optimiser: torch.optim.Adam, rate: float, loss: torch.Tensor) -> float:
    """One step at `rate`; none where a batch shows nothing that depends on the networks. The loss."""
    optimiser.param_groups[0]["lr"] = rate
    if loss.requires_grad:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
    return loss.item()


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


def read(rival: Rival, folder: Path) -> tuple[float, int]:
    """Load what a run has learnt; in how many seconds and steps. Raises `InputError` where it has no checkpoint that is whole."""
    found = checkpoint.newest(folder / "checkpoints")
    if found is None:
        raise InputError(folder, "checkpoints", "one that is whole", "none")
    rival.load_state_dict(found[1]["networks"])
    return float(found[1]["seconds"]), found[0].manifest.step
