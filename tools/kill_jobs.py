"""Jobs killed at random moments and on disks that fill, gone on with, and compared with undisturbed ones bit for bit.

    python tools/kill_jobs.py FOLDER [--seed N] [--kills N] [--full-disks N] [--jobs NAME,…]

Each kind of job runs once undisturbed. Then it is begun anew, killed (SIGKILL) at a moment between its first file and its end, and started
again with the same words until all kills are spent and it has ended: what it has made must be what the undisturbed one has. On a disk with a
random share of the room that it needs (a tmpfs: for root alone) it must end with one line that says so; with more room it goes on. Kills and
disks are dealt out to the kinds by turns. FOLDER takes sources, logs and disks; exit code 1 where anything differs.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import job_results
from job_kinds import Job, jobs

ROOMY = 8 * 2**30
"""Bytes of a disk that does not fill; of a tmpfs only what is used is taken."""
SMALLEST = 2**16
SHARES = (0.02, 0.95)
"""Of the room that a job needs: a full disk's."""
POLL = 0.02
"""Seconds between two looks."""
IN_VAIN = 6
"""Moments for each kill: a job that goes on may have ended before its moment."""
LONGEST = 1800.0
"""Seconds for one start."""


@dataclass(frozen=True)
class Whole:
    """An undisturbed job."""

    made: job_results.Made
    first: float
    """Seconds from its start to its first file."""
    seconds: float
    room: int
    """Bytes that it needed at most."""


@dataclass
class Row:
    """What was done to a kind of job."""

    job: str
    kills: int = 0
    full: int = 0
    starts: int = 0
    compared: int = 0
    wrong: list[str] = field(default_factory=list)

    def compare(self, whole: Whole, made: job_results.Made) -> None:
        """With an undisturbed one."""
        self.compared += 1
        names = sorted(whole.made.keys() | made.keys())
        unlike = [name for name in names if whole.made.get(name) != made.get(name)]
        if unlike:
            self.wrong.append(f"{self.job}: {len(unlike)} of {len(names)} differ: {', '.join(unlike[:4])}")


@dataclass(frozen=True)
class Place:
    """Where jobs work and write their logs."""

    folder: Path

    @contextmanager
    def disk(self, size: int = ROOMY) -> Iterator[Path]:
        """A new one of `size` bytes; for others than root a folder."""
        out = self.folder / "disk"
        if out.is_mount():  # of a run that was killed itself
            subprocess.run(["umount", str(out)], check=True)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        if os.geteuid() != 0:
            yield out
            return
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(out)], check=True)
        try:
            yield out
        finally:
            subprocess.run(["umount", str(out)], check=True)

    def enlarge(self) -> None:
        """The disk that is mounted."""
        subprocess.run(["mount", "-o", f"remount,size={ROOMY}", str(self.folder / "disk")], check=True)

    def start(self, job: Job, out: Path, until: float = LONGEST) -> tuple[int | None, str]:
        """Begin or go on; exit code and what was said last. None: killed after `until` seconds."""
        log = self.folder / f"{job.name}.log"
        with open(log, "ab") as said:
            place = said.tell()
            process = subprocess.Popen(job.words(out), stdin=subprocess.DEVNULL, stdout=said, stderr=said)
            try:
                code: int | None = process.wait(until)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                code = None
        return code, log.read_bytes()[place:].decode(errors="replace")


def undisturbed(job: Job, place: Place) -> Whole:
    """Run it, and look at its folder meanwhile. Raises `RuntimeError` where it fails."""
    with place.disk() as out, open(place.folder / f"{job.name}.log", "wb") as said:
        begun, first, room = time.monotonic(), 0.0, 0
        process = subprocess.Popen(job.words(out), stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        while process.poll() is None:
            room = max(room, shutil.disk_usage(out).used)
            first = first or (time.monotonic() - begun if any(out.iterdir()) else 0.0)
            time.sleep(POLL)
        if process.returncode != 0:
            raise RuntimeError(f"{job.name} fails undisturbed: {said.name}")
        return Whole(job.made(out), first, time.monotonic() - begun, max(room, shutil.disk_usage(out).used))


def killed(job: Job, whole: Whole, place: Place, row: Row, rng: random.Random, kills: int) -> None:
    """Begin it as often as it takes to kill it `kills` times, and compare each that has ended."""
    for _ in range(IN_VAIN * kills):
        if row.kills == kills:
            return
        with place.disk() as out:
            code: int | None = None
            while code is None:
                moment = rng.uniform(whole.first, whole.seconds) if row.kills < kills else LONGEST
                code, said = place.start(job, out, moment)
                row.starts += 1
                row.kills += code is None
            if code:
                row.wrong.append(f"{job.name}: does not go on after a kill: {last_line(said)}")
            else:
                row.compare(whole, job.made(out))
    if row.kills < kills:
        row.wrong.append(f"{job.name}: killed {row.kills} times in {row.starts} starts, expected {kills}")


def filled(job: Job, whole: Whole, place: Place, row: Row, share: float) -> None:
    """On a disk with a share of the room that it needs, then on a larger one."""
    with place.disk(max(int(share * whole.room), SMALLEST)) as out:
        code, said = place.start(job, out)
        row.full += 1
        row.starts += 1
        if code == 0:
            row.wrong.append(f"{job.name}: ended well with {share:.0%} of the room that it needs")
        elif "Traceback" in said or "space" not in last_line(said):
            row.wrong.append(f"{job.name}: a full disk ({share:.0%}) is not said in one line: {last_line(said)}")
        place.enlarge()
        code, said = place.start(job, out)
        row.starts += 1
        if code:
            row.wrong.append(f"{job.name}: does not go on after a full disk ({share:.0%}): {last_line(said)}")
        else:
            row.compare(whole, job.made(out))


def last_line(said: str) -> str:
    """Of what a job has said, bars left out."""
    lines = [line for line in said.replace("\r", "\n").splitlines() if line.strip()]
    return lines[-1] if lines else "nothing"


def dealt(total: int, kinds: int) -> list[int]:
    """A total by turns."""
    return [total // kinds + (kind < total % kinds) for kind in range(kinds)]


def table(rows: list[Row]) -> str:
    """With a line for each kind."""
    head = f"{'job':10} {'kills':>6} {'full disks':>11} {'starts':>7} {'compared':>9} {'differ':>7}"
    return "\n".join(
        [
            head,
            *(
                f"{row.job:10} {row.kills:6d} {row.full:11d} {row.starts:7d} {row.compared:9d} {len(row.wrong):7d}"
                for row in rows
            ),
        ]
    )


def tried(kinds: list[Job], place: Place, seed: int, kills: int, disks: int) -> list[Row]:
    """Every kind with its share of kills and full disks."""
    rows = []
    for job, its_kills, its_disks in zip(kinds, dealt(kills, len(kinds)), dealt(disks, len(kinds))):
        row, rng = Row(job.name), random.Random(f"{seed} {job.name}")
        whole = undisturbed(job, place)
        print(f"{job.name}: {whole.seconds:.0f} s undisturbed, {whole.room / 2**20:.0f} MiB", flush=True)
        killed(job, whole, place, row, rng, its_kills)
        for _ in range(its_disks):
            filled(job, whole, place, row, rng.uniform(*SHARES))
        print("\n".join(row.wrong) or f"{job.name}: all as undisturbed", flush=True)
        rows.append(row)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Kill jobs and fill their disks; what they have made in the end must be the same."
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--full-disks", type=int, default=10)
    parser.add_argument("--jobs", help="some of the kinds, with commas")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    kinds = jobs(given.folder.resolve())
    known = [job.name for job in kinds]
    chosen = given.jobs.split(",") if given.jobs else known
    if not set(chosen) <= set(known):
        parser.error(f"--jobs: expected some of {','.join(known)}, found {given.jobs}")
    disks = given.full_disks if os.geteuid() == 0 else 0
    if disks < given.full_disks:
        print("full disks: left out, mounting one is for root alone")
    rows = tried(
        [job for job in kinds if job.name in chosen], Place(given.folder.resolve()), given.seed, given.kills, disks
    )
    print(table(rows))
    return int(any(row.wrong for row in rows))


if __name__ == "__main__":
    sys.exit(main())
