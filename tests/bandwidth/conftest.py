"""cp_tiny with seeded weights, and frames of the tiny data set."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.bandwidth.late_fusion import Boxes
from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.models import build_network

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"


@pytest.fixture(scope="session")
def tiny_set(tiny_data):
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    return cfg, build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="train")


@pytest.fixture(scope="session")
def network(tiny_set):
    """With random weights that find something everywhere, and no branch that is still zero."""
    cfg, dataset = tiny_set
    torch.manual_seed(0)
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            if not parameter.any():
                parameter.copy_(0.05 * torch.randn(parameter.shape))
        network.dense_head.conv_cls.bias.fill_(-1.0)
    return network


@pytest.fixture(scope="session")
def batch_of(tiny_set):
    """``batch_of(index, combo)``: one frame as the network takes it."""
    _, dataset = tiny_set
    return lambda index, combo: load_batch(dataset.collate_batch([dataset[(index, combo)]]), "cpu")


@pytest.fixture(scope="session")
def boxes_of():
    """``boxes_of((x, y, score, label), ...)``: cars of one size, heading along x."""

    def make(*rows):
        boxes = np.array([[x, y, 0.8, 4.6, 1.9, 1.6, 0.0] for x, y, _, _ in rows], np.float32).reshape(-1, 7)
        scores, labels = (np.array([row[k] for row in rows]) for k in (2, 3))
        return Boxes(torch.from_numpy(boxes), torch.tensor(scores, dtype=torch.float32), torch.tensor(labels).long())

    return make
