"""One process or several under ``torchrun``: gloo between CPUs, nccl between GPUs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from pcdet_avp.errors import ConfigError

LAUNCHERS = ("none", "pytorch")
# Variables with the number of processes that others than torchrun start, and who does.
FOREIGN_LAUNCHERS = {"SLURM_STEP_NUM_TASKS": "srun", "OMPI_COMM_WORLD_SIZE": "Open MPI", "PMI_SIZE": "MPI"}
TIMEOUT = timedelta(minutes=30)  # rank 0 may evaluate and write pictures while the others wait


@dataclass(frozen=True)
class Ranks:
    """Which of the processes this one is, and where it computes."""

    device: torch.device
    rank: int = 0
    world: int = 1

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def wrap(self, model: nn.Module) -> nn.Module:
        """``model``, averaging its gradients over the ranks if there are several; parameters may go unused."""
        if self.world == 1:
            return model
        ids = [self.device.index] if self.device.type == "cuda" else None
        return DistributedDataParallel(model, device_ids=ids, find_unused_parameters=True)

    def any(self, flags: Sequence[bool]) -> list[bool]:
        """Each flag, or-ed over the ranks: how they agree to stop or to save in the same iteration."""
        if self.world == 1:
            return list(flags)
        votes = torch.tensor([float(f) for f in flags], device=self.device)
        dist.all_reduce(votes, op=dist.ReduceOp.MAX)
        return [vote > 0 for vote in votes.tolist()]

    def gather(self, value: Any) -> list[Any]:
        """The value of every rank, on every rank."""
        if self.world == 1:
            return [value]
        values: list[Any] = [None] * self.world
        dist.all_gather_object(values, value)
        return values

    def wait(self) -> None:
        """Until every rank is here: what rank 0 wrote before can be read after."""
        self.gather(None)

    def from_first(self, value: Any) -> Any:
        """Rank 0's value, on every rank."""
        return self.gather(value)[0]


def start(launcher: str | None = None, device: str | None = None, alone: bool = False) -> Ranks:
    """Join the other processes that the launcher started; ``device`` is cpu or cuda, by default what there is.

    ``launcher`` None: found out from the environment. ``alone``: the tool computes in one process; it is an error to
    start several, which would write over each other's files.
    """
    others = _started_by_launcher()
    if others and (alone or launcher == "none"):
        raise ConfigError(f"{others}: expected one process; several would write over each other's files")
    launcher = launcher or ("pytorch" if others else "none")
    if launcher not in LAUNCHERS:
        raise ConfigError(f"--launcher: unknown {launcher!r}; known: {', '.join(LAUNCHERS)}")
    kind = device or ("cuda" if torch.cuda.is_available() else "cpu")
    if kind.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError("--device cuda: this torch sees no GPU")
    if launcher == "none":
        return Ranks(torch.device(kind))
    rank, world, local_rank = (_from_environment(name) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"))
    if kind == "cuda":
        torch.cuda.set_device(local_rank)
        kind = f"cuda:{local_rank}"
    dist.init_process_group("nccl" if kind.startswith("cuda") else "gloo", timeout=TIMEOUT)
    return Ranks(torch.device(kind), rank, world)


def _started_by_launcher() -> str:
    """What in the environment says that this process is one of several, or nothing; ConfigError if we cannot join."""
    world = os.environ.get("WORLD_SIZE", "")
    if world.isdecimal() and int(world) > 1:
        return f"WORLD_SIZE {world} in the environment"
    for name, who in FOREIGN_LAUNCHERS.items():
        count = os.environ.get(name, "")
        if "RANK" not in os.environ and count.isdecimal() and int(count) > 1:
            raise ConfigError(
                f"{who} started {count} processes ({name}), each of which would be a run of its own in one folder; "
                "let it start one per machine, and that torchrun --nproc_per_node N"
            )
    return ""


def stop() -> None:
    """Leave the process group, if there is one."""
    if dist.is_available() and dist.is_initialized():
        dist.destroy_process_group()


def _from_environment(name: str) -> int:
    try:
        return int(os.environ[name])
    except (KeyError, ValueError) as error:
        raise ConfigError(
            f"--launcher pytorch: environment variable {name} is missing; start with torchrun --nproc_per_node N"
        ) from error
