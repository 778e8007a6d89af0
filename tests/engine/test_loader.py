"""Worker processes give the batches that the main process would make, whatever starts them."""

import logging
import multiprocessing
import pickle
from pathlib import Path

import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"
KEYS = [[(0, "CL+CL", 0), (1, "CL+CL", 0)], [(2, "C+C", 3), (0, "C+C", 3)]]


@pytest.fixture
def dataset(tiny_data):
    """Training data with every augmentation, and a log that no other process can have."""
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    cfg.DATA_CONFIG.DATA_AUGMENTOR.DISABLE_AUG_LIST = []
    return build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True, logger=logging.Logger("a run's"))


@pytest.fixture
def start_by():
    """``start_by(method)``: how multiprocessing starts processes from now on, as Python 3.14 has forkserver."""
    before = multiprocessing.get_start_method()
    yield lambda method: multiprocessing.set_start_method(method, force=True)
    multiprocessing.set_start_method(before, force=True)


def same(ours, theirs):
    assert ours.keys() == theirs.keys()
    tensors = [key for key, value in ours.items() if isinstance(value, torch.Tensor)]
    return len(tensors) >= 10 and all(torch.equal(ours[key], theirs[key]) for key in tensors)


def test_training_data_survive_the_way_to_another_process(dataset):
    there = pickle.loads(pickle.dumps(dataset))
    assert there.logger is None
    assert dataset.logger is not None
    for key in KEYS[0] + KEYS[1]:
        ours, theirs = dataset[key], there[key]
        assert all((ours[name] == theirs[name]).all() for name in ("points", "images_infra", "gt_boxes"))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_workers_of_every_start_method_give_the_same_batches(dataset, start_by, method):
    ranks = Ranks(torch.device("cpu"))
    expected = list(batches(dataset, KEYS, ranks, workers=0))
    start_by(method)
    found = list(batches(dataset, KEYS, ranks, workers=2))
    assert len(found) == 2
    assert all(same(*pair) for pair in zip(found, expected, strict=True))
