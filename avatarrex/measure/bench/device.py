"""The machine that a measurement was made on, as far as its figures depend on it; no names of hosts or users."""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path
from typing import Any

import torch

from avatarrex.gl.context import gl_context, gl_unavailable, renderer_name


def describe(networks: str = "cpu") -> dict[str, Any]:
    """Processor, cores, threads, renderer, GPU, versions, and where the networks of whole frames run."""
    missing = gl_unavailable()
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "cpu": _cpu(),
        "vectors": torch.backends.cpu.get_cpu_capability(),
        "cores": cores(),
        "threads": torch.get_num_threads(),
        "renderer": renderer_name(gl_context()) if missing is None else f"none: {missing}",
        "gpu": gpu,
        "networks": networks,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "system": platform.system(),
    }


def device_class(device: dict[str, Any]) -> str:
    """Machines with comparable ratios, as a file's name: `linux-2-cores-avx2-llvmpipe`."""
    drawn = re.split(r"[ (/:]", str(device["renderer"]))[0] or "none"
    words = [device["system"], f"{device['cores']}-cores", device["vectors"], device["gpu"] or drawn]
    placed = device.get("networks", "cpu")
    words += [] if placed == "cpu" else ["networks", "on", placed]
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu() -> str:
    listed = Path("/proc/cpuinfo")
    if listed.is_file():
        found = re.search(r"^model name\s*:\s*(.+)$", listed.read_text(), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or platform.machine()
