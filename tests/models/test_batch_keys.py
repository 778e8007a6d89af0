"""The table of batch keys in docs/network.md lists what the data set and the network write, no more and no less."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.link import MapStamp, decode, encode
from pcdet_avp.models import build_network
from pcdet_avp.models.detectors.split_inference import VehicleHalf, latent_shape
from pcdet_avp.structures.pose import Pose

ROOT = Path(__file__).parents[2]
OF_RECEIVED_MAPS = {"ego_from_sender", "map_samples"}  # only what received maps bring
OF_REGISTRATION = {"correction_memory", "corrections"}  # only where MODEL.REGISTRATION is on
OF_INFERENCE = {"placed", "min_scores"}  # only in the vehicle's half on two threads, and in ``detect``


def listed_keys():
    """The keys in the first column of the table below "Keys of batch_dict"."""
    section = (ROOT / "docs" / "network.md").read_text(encoding="utf-8").split("## Keys of `batch_dict`")[1]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    return [key for row in rows for key in re.findall(r"`(\w+)`", row.split("|")[1])]


@pytest.fixture(scope="module")
def network_and_batch(tiny_data):
    cfg = load_config(ROOT / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="train")
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset)
    return network, load_batch(dataset.collate_batch([dataset[0, "CL+CL"], dataset[1, "CL+CL"]]), "cpu")


def test_the_table_has_every_key_of_a_forward_pass_and_no_other(network_and_batch):
    network, batch = network_and_batch
    with torch.no_grad():
        written = set(network.eval().run_stages(dict(batch)))
    keys = listed_keys()
    assert len(keys) == len(set(keys))
    assert set(keys) - OF_RECEIVED_MAPS - OF_REGISTRATION - OF_INFERENCE == written


def test_the_vehicles_half_on_two_threads_says_that_received_maps_are_placed(network_and_batch):
    network, batch = network_and_batch
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with torch.inference_mode():
            latents = network.eval().encode_roadside(dict(batch))
            assert network.encode_vehicle({**batch, "latents": latents})["placed"]
    finally:
        torch.set_num_threads(before)
    assert network._asked_for().keys() | {"placed"} == OF_INFERENCE


def test_received_maps_bring_the_keys_that_the_table_calls_optional(network_and_batch):
    network, _ = network_and_batch
    shape = latent_shape(network)
    stamp = MapStamp(0, 0, "lidar", 0.0, 0.0, 0.0)
    known = decode(encode(np.zeros(shape, np.float32), stamp, 60_000))
    assert set(VehicleHalf._received(torch.zeros(1), Pose.identity(), [known])) == OF_RECEIVED_MAPS | {"latents"}


def test_training_writes_no_key_that_the_table_lacks(network_and_batch):
    network, batch = network_and_batch
    with torch.no_grad():
        written = set(network.train().run_stages(dict(batch)))
    assert written <= set(listed_keys())
