"""Seeds of torch's random numbers, and their state for a resumed run."""

from __future__ import annotations

import numpy as np
import torch


def seed_torch(seed: int, *stream: int, deterministic: bool = False) -> None:
    """Seed torch's generators, CPU and GPU, for a purpose or rank; ``deterministic`` also refuses racing kernels."""
    torch.manual_seed(int(np.random.SeedSequence((seed, *stream)).generate_state(1, np.uint64)[0] >> np.uint64(1)))
    if deterministic:
        torch.use_deterministic_algorithms(True, warn_only=True)
        torch.backends.cudnn.benchmark = False


def random_state(device: torch.device) -> dict[str, torch.Tensor]:
    """torch's generator states of this process, as tensors."""
    state = {"cpu": torch.get_rng_state()}
    if device.type == "cuda":
        state["cuda"] = torch.cuda.get_rng_state(device)
    return state


def restore_random_state(state: dict[str, torch.Tensor], device: torch.device) -> None:
    """Go on where ``random_state`` was taken; a GPU's state is skipped where there is no GPU now."""
    torch.set_rng_state(state["cpu"].cpu())
    if device.type == "cuda" and "cuda" in state:
        torch.cuda.set_rng_state(state["cuda"].cpu(), device)
