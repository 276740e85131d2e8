"""What a figure was measured on: versions, machine and git revision."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "torch", "casadi", "pin", "coal", "eaik", "trimesh", "joblib", "plotly")


def environment() -> dict[str, Any]:
    """Return versions and machine, JSON-serialisable."""
    versions = {"python": platform.python_version(), "regrasp-opt": _version("regrasp-opt")}
    versions |= {name: _version(name) for name in PACKAGES}
    machine = {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "accelerator": _accelerator(),
    }
    return {"versions": versions, "machine": machine, "revision": git_revision()}


@cache
def git_revision() -> str:
    """Return the revision of the code, with ``-dirty`` where files differ from it, or ``unknown`` outside a clone."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return done.stdout.strip() if done.returncode == 0 and done.stdout.strip() else "unknown"


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _accelerator() -> str:
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
