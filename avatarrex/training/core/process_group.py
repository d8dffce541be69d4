"""The processes that train one avatar together: who they are, which share of a step each computes, and what they exchange.

`torchrun` starts them (docs/scale.md). Every process draws the same batch by the same generators, evaluates its share of it,
and adds up with the others what the gradients are; so all make the step that one alone would have made, to rounding.
gloo carries what lies on the CPU, nccl what lies on a GPU.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from fractions import Fraction

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.distributed.distributed_c10d import PrefixStore, Store
from torch.distributed.rendezvous import rendezvous

from avatarrex.errors import InputError

PATIENCE = timedelta(days=7)
"""For the others: a training may be paused. A process that has died is noticed at once, by its closed connection."""
STARTING = timedelta(minutes=10)
"""For the others to start: one that never does closes no connection."""


class PeerLost(RuntimeError):
    """Another process of the training has ended."""


@dataclass(frozen=True)
class Share:
    """What one process computes of one unit of a batch (a frame, a patch)."""

    unit: int
    begin: Fraction
    end: Fraction
    """Of the unit, 0 to 1."""

    def rows(self, count: int) -> slice:
        """Its own of so many rays, points or pixels; the shares of all processes have each row once."""
        return slice(round(self.begin * count), round(self.end * count))

    @property
    def size(self) -> float:
        """0 to 1."""
        return float(self.end - self.begin)


WHOLE = Share(0, Fraction(0), Fraction(1))


@dataclass(frozen=True)
class ProcessGroup:
    """This process among `size`."""

    rank: int = 0
    size: int = 1
    kept: Store | None = None
    """Of torchrun, which keeps it while it starts its processes again."""

    @property
    def leads(self) -> bool:
        """Whether it is the one that writes, prints and answers viewers."""
        return self.rank == 0

    def shares(self, units: int) -> list[Share]:
        """Of a batch of units laid end to end this process's stretch, unit by unit: whole ones where the numbers agree."""
        begin, end = Fraction(self.rank * units, self.size), Fraction((self.rank + 1) * units, self.size)
        touched = range(int(begin), -int(-end // 1))
        return [Share(unit, max(begin - unit, Fraction(0)), min(end - unit, Fraction(1))) for unit in touched]

    def sum(self, values: Tensor) -> Tensor:
        """Of every process's values, elementwise; without a gradient, and the same bits everywhere."""
        if self.size == 1:
            return values.detach()
        total = values.detach().clone()
        with _peers():
            dist.all_reduce(total)
        return total

    def joined(self, own: Tensor) -> Tensor:
        """The sum of tensors that are zero where another process has its share; the gradient is that of the own."""
        return own if self.size == 1 else own + (self.sum(own) - own.detach())

    def any(self, wish: bool) -> bool:
        """Whether some process says so."""
        return wish if self.size == 1 else bool(self.sum(torch.tensor([float(wish)])) > 0)

    def add_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Each gradient becomes the sum of all processes'; what none has a gradient of stays without."""
        if self.size == 1:
            return
        listed = list(parameters)
        known = self.sum(torch.tensor([float(one.grad is not None) for one in listed]))
        learnt = [one for one, count in zip(listed, known.tolist()) if count]
        for device in sorted({str(one.device) for one in learnt}):
            some = [one for one in learnt if str(one.device) == device]
            slopes = [torch.zeros_like(one) if one.grad is None else one.grad for one in some]
            total = self.sum(torch.cat([slope.reshape(-1) for slope in slopes]))
            for one, slope, part in zip(some, slopes, total.split([len(slope.reshape(-1)) for slope in slopes])):
                one.grad = slope.copy_(part.view(slope.shape))

    def agree(self, modules: Iterable[nn.Module]) -> None:
        """Everybody's weights become the leader's, bit for bit."""
        if self.size == 1:
            return
        with _peers(), torch.no_grad():
            for value in (value for module in modules for value in module.state_dict().values()):
                sent = value.contiguous()
                dist.broadcast(sent, 0)
                value.copy_(sent)

    def wait(self) -> None:
        """Until every process is here."""
        self.any(False)

    def note(self, name: str, value: str) -> None:
        """Say something to the processes that torchrun starts again after these."""
        if self.kept is not None:
            self.kept.set(name, value)

    def noted(self, name: str) -> str | None:
        """What a process of the same torchrun said, in this start or one before; None where none did."""
        if self.kept is None or not self.kept.check([name]):
            return None
        return bytes(self.kept.get(name)).decode()


ALONE = ProcessGroup()


@contextlib.contextmanager
def process_group(device: str) -> Iterator[tuple[ProcessGroup, str]]:
    """The group that torchrun has started this process in, and where its networks run: `cuda` is a GPU for each process of a machine.

    A process that does not lead prints nothing. Raises `InputError` for a device that processes cannot share, and
    `PeerLost` where the others do not start.
    """
    if not dist.is_torchelastic_launched():
        yield ALONE, device
        return
    kind, _, number = device.partition(":")
    several = int(os.environ["LOCAL_WORLD_SIZE"]) > 1
    if number and several:
        raise InputError("--device", "", f"{kind}, of which every process takes its own", device)
    if kind == "cuda" and several:
        device = f"cuda:{os.environ['LOCAL_RANK']}"
        if int(os.environ["LOCAL_RANK"]) >= torch.cuda.device_count():
            found = f"{torch.cuda.device_count()} for {os.environ['LOCAL_WORLD_SIZE']} processes"
            raise InputError("--device", "", "a GPU for each process", found)
    kept, started, rank, size = _started()
    backends = "cpu:gloo,cuda:nccl" if kind == "cuda" else "gloo"
    dist.init_process_group(backends, store=started, rank=rank, world_size=size, timeout=PATIENCE)
    group = ProcessGroup(rank, size, kept)
    try:
        with contextlib.nullcontext() if group.leads else _silent():
            yield group, device
    finally:
        dist.destroy_process_group()


def leads() -> bool:
    """Whether torchrun calls this process the first; also without a group, before it is there and after it broke."""
    return os.environ.get("RANK", "0") == "0"


def under_torchrun() -> bool:
    """Whether torchrun started this process: it starts all again where one ends with another exit code than 0."""
    return dist.is_torchelastic_launched()


def _started() -> tuple[Store, Store, int, int]:
    """What torchrun keeps, that of it for this start alone, rank and size, once all processes are here. Raises `PeerLost`."""
    try:
        kept, rank, size = next(rendezvous("env://", timeout=STARTING))
        # After a restart torchrun's store still has the addresses of the processes that are gone.
        start = PrefixStore(f"start_{os.environ['TORCHELASTIC_RESTART_COUNT']}", kept)
        start.set(f"here_{rank}", "")
        start.wait([f"here_{other}" for other in range(size)], STARTING)
    except RuntimeError as error:
        found = f"another process of this training has not started within {STARTING.total_seconds() / 60:.0f} min"
        raise PeerLost(found) from error
    for store in (kept, start):
        store.set_timeout(PATIENCE)
    return kept, start, rank, size


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing), contextlib.redirect_stderr(nothing):
        yield


@contextlib.contextmanager
def _peers() -> Iterator[None]:
    """What a broken connection says in one line."""
    try:
        yield
    except RuntimeError as error:
        raise PeerLost(
            "another process of this training has ended; --resume goes on from the last checkpoint"
        ) from error
