"""An untrained tiny network at the wheel."""

from pathlib import Path

import pytest
import torch

from pcdet_avp.closed_loop.perception.network import untrained
from pcdet_avp.config import load_config

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml")


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def driving():
    driving = untrained(CFG)
    driving.network.post_processing.min_scores = [0.0095, 0.0095]  # an untrained network is sure of nothing
    return driving
