"""Provenance of figures: the ``meta`` part of every result file."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pcdet_avp
from pcdet_avp.config import config_hash

PACKAGES = ("torch", "numpy", "numba", "scipy", "opencv-python-headless", "embreex")


def provenance(
    cfg: Mapping, config_name: str, *, seed: int | None, weights_hash: str | None = None, started: float | None = None
) -> dict[str, Any]:
    """Configuration, command, versions, seed, commit, hashes, machine, wall time; ``started`` is a ``time.time()``."""
    return {
        "config": config_name,
        "config_hash": config_hash(cfg),
        "command": command(),
        "versions": versions(),
        "git_commit": git_commit(),
        "seed": seed,
        "weights_hash": weights_hash,
        "machine": machine(),
        "wall_time_s": None if started is None else round(time.time() - started, 1),
    }


def command() -> str:
    """The command line of this process, without the folder that Python or a console script lies in."""
    program, module = Path(sys.argv[0]), getattr(sys.modules["__main__"], "__spec__", None)
    start = [Path(sys.executable).name, sys.argv[0]]
    if module is not None and module.name.startswith("pcdet_avp."):
        start = [Path(sys.executable).name, "-m", module.name]
    elif program.suffix != ".py":
        start = [program.name]
    return shlex.join([*start, *sys.argv[1:]])


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of the libraries that compute."""
    found = {"python": platform.python_version(), "pcdet_avp": pcdet_avp.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def git_commit() -> str | None:
    """The commit of the checkout that this package runs from, "+changed" if files differ; None outside of one."""
    folder = Path(pcdet_avp.__file__).parent
    tracked = _git(folder, "ls-files", "--error-unmatch", "__init__.py")
    commit = _git(folder, "rev-parse", "HEAD") if tracked is not None else None
    if commit is None:
        return None
    return commit + ("+changed" if _git(folder, "status", "--porcelain", "--untracked-files=no", ".") else "")


def machine() -> dict[str, Any]:
    """Processor, cores, threads and GPU; no name of the computer or its user."""
    facts = {"system": platform.system(), "processor": _processor(), "cores": os.cpu_count()}
    torch = sys.modules.get("torch")  # only if the caller computes with it
    if torch is not None:
        facts["torch_threads"] = torch.get_num_threads()
        facts["gpu"] = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return facts


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
