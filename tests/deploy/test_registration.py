"""An exported network's vehicle corrects poses by the same motion as the network in torch."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from garage_of_lines import GRID, POOLING, TRUTH, drawn, seen, walls

from pcdet_avp.deploy.halves import Opened, Received, VehicleHalf
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.fusion.register import RegisterMaps
from pcdet_avp.registration import Registrar, RegistrationSettings
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SOURCES
from pcdet_avp.structures.stage_times import untimed

ON = RegistrationSettings(enabled=True)
BELIEVED = (Pose.from_xyz_yaw(0.5, -0.3, yaw=np.radians(2.0)) @ TRUTH).matrix.astype(np.float32)


@pytest.fixture
def half():
    """A vehicle's half whose only graph repeats what is received over the cells that were pooled."""
    half = object.__new__(VehicleHalf)
    half._registrar, half._memory, half._network = Registrar(GRID, ON), None, SimpleNamespace(grid=GRID)
    half.stages = untimed
    half._graphs = lambda name, latent: {"bev_map": latent.repeat(POOLING, 2).repeat(POOLING, 3)}
    return half


def opened(sent, present):
    return Opened(sent.repeat(POOLING, 1).repeat(POOLING, 2)[None], present, BELIEVED)


@pytest.fixture(scope="module")
def maps():
    own = drawn(walls(), GRID.cell_m, 3, 0.3)[None]
    return own, drawn(seen(walls(), TRUTH.inverse()), POOLING * GRID.cell_m, 3, 0.05)


def test_the_correction_is_torchs(half, maps):
    own, sent = maps
    valid, present = np.ones((1, 1, *own.shape[2:]), bool), np.ones(sent.shape[1:], bool)
    received = {source: [opened(sent, present)] for source in ("infra_lidar", "infra_camera")}
    found = half._registered({"ego_lidar": (own, valid)}, received)
    batch = {
        "batch_size": 1,
        "bev_maps": {"ego_lidar": torch.from_numpy(own)},
        "bev_valid": {"ego_lidar": torch.from_numpy(valid)},
        "latents": {"infra_lidar": Latent(torch.from_numpy(sent)[None], torch.from_numpy(present)[None, None])},
        "ego_from_infra": torch.from_numpy(BELIEVED)[None],
    }
    expected = RegisterMaps(GRID, ON)(batch)["ego_from_infra"][0]
    assert not np.array_equal(expected, BELIEVED)
    for source in received:
        np.testing.assert_allclose(found[source][0].ego_from_sender, expected, atol=1e-6)


def test_without_the_own_lidar_what_was_received_stays(half, maps):
    received = {"infra_lidar": [opened(maps[1], np.ones(maps[1].shape[1:], bool))]}
    assert half._registered({}, received) is received


def test_off_by_default(half, maps):
    half._registrar = None
    received = {"infra_lidar": [opened(maps[1], np.ones(maps[1].shape[1:], bool))]}
    assert half._registered({}, received) is received


def test_every_received_map_is_decompressed_once(half, maps):
    own, sent = maps
    repeat, opened_graphs, placed = half._graphs, [], []
    half._graphs = lambda name, latent: opened_graphs.append(name) or repeat(name, latent)
    half._encoders = SimpleNamespace(encode=lambda sample, source: (own, np.ones((1, 1, *own.shape[2:]), bool)))
    half._placed = lambda known: placed.append(known) or (known.bev_map, np.ones((1, 1, *own.shape[2:]), bool))
    half.head = lambda maps: maps
    known = Received(sent, np.ones(sent.shape[1:], bool), BELIEVED)
    present = np.array([source == "ego_lidar" for source in SOURCES])
    half.run({"source_present": present}, {"infra_camera": known, "infra_lidar": [known, known]})
    assert opened_graphs == ["decompress_camera", "decompress_lidar", "decompress_lidar"]
    assert len(placed) == 3
    assert not any(np.array_equal(each.ego_from_sender, BELIEVED) for each in placed)
