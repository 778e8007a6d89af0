"""The network in two places, with bytes in between, finds what it finds in one."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.errors import ConfigError
from pcdet_avp.link import MapSize, MapStamp, Receiver, decode, encode
from pcdet_avp.models.compression import NoCompression
from pcdet_avp.models.detectors.split_inference import RoadsideHalf, VehicleHalf, latent_shape
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

NOTHING = SensorSet(False, False, False, False)
MUCH = 72_000


@pytest.fixture(scope="module")
def poses(tiny_set):
    _, dataset = tiny_set
    frame = dataset.read(0, NOTHING)
    return frame.ego.world_from_agent, frame.infra.world_from_agent


def received(network, batch, world_from_infra, budget):
    half, receiver = RoadsideHalf(network, 400, budget), Receiver(latent_shape(network))
    for payloads in half.segments(batch, 7, 350_000, world_from_infra).values():
        assert sum(map(len, payloads)) <= budget
        assert all(receiver.push(payload) for payload in payloads)
    return [receiver.take(modality, 350_000) for modality in ("camera", "lidar")]


def test_both_halves_together_are_the_network(network, batch_of, poses):
    """The pose travels as float32, and the memory format of what arrives is another: the last bits differ."""
    world_from_ego, world_from_infra = poses
    batch = batch_of(0, "CL+CL")
    maps = received(network, batch, world_from_infra, MUCH)
    assert [known.stamp.frame_id for known in maps] == [7, 7]
    found = VehicleHalf(network).detect(batch_of(0, "CL+none"), world_from_ego, maps)
    with torch.no_grad():
        whole = network(batch)[0][0]
    assert len(found["pred_scores"]) == len(whole["pred_scores"]) > 5
    torch.testing.assert_close(found["pred_scores"], whole["pred_scores"], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found["pred_boxes"], whole["pred_boxes"], atol=1e-3, rtol=1e-3)


def test_an_old_map_lies_where_the_vehicle_is_now(network):
    """By hand: the mast at x = 40 looks back; what stands 10 m before it is 30 m ahead of the vehicle at first, and
    28.4 m once that has driven 1.6 m, whatever the age of the map."""
    sender, shape = Pose.from_xyz_yaw(40.0, 0.0, yaw=np.pi), latent_shape(network)
    known = decode(encode(np.zeros(shape, np.float32), MapStamp.at_pose(0, 0, "lidar", sender), 60_000))
    for driven, ahead in ((0.0, 30.0), (1.6, 28.4)):
        batch = VehicleHalf._received(torch.zeros(1), Pose.from_xyz_yaw(driven, 0.0), [known])
        place = batch["ego_from_sender"]["infra_lidar"][0] @ torch.tensor([10.0, 0.0, 0.0, 1.0])
        torch.testing.assert_close(place[:2], torch.tensor([ahead, 0.0]), atol=1e-4, rtol=0)


def test_without_maps_the_vehicle_is_alone(network, batch_of, poses):
    batch = batch_of(0, "CL+none")
    with torch.no_grad():
        alone = network(batch)[0][0]
    assert torch.equal(VehicleHalf(network).detect(batch, poses[0], [])["pred_scores"], alone["pred_scores"])


def test_the_budget_holds_for_each_map(network, batch_of, poses):
    maps = received(network, batch_of(0, "CL+CL"), poses[1], 500)
    assert all(0 < known.values.any(0).sum() < known.present.size for known in maps)


def test_maps_of_constant_size_are_one_packet_each_that_the_vehicle_reads(network, batch_of, poses, monkeypatch):
    monkeypatch.setattr(network.codec, "map_size", MapSize(500, constant=True))
    half, receiver = RoadsideHalf(network, 700), Receiver(latent_shape(network))
    for (payload,) in half.segments(batch_of(0, "CL+CL"), 7, 350_000, poses[1], sender=3).values():
        assert len(payload) == 500
        assert receiver.push(payload)
    maps = receiver.take_all(now_us=0)
    assert [(known.stamp.modality, known.stamp.sender) for known in maps] == [("camera", 3), ("lidar", 3)]
    assert all(known.present.all() and known.values.any() for known in maps)
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES of 400 or less"):
        RoadsideHalf(network, 400)


def test_a_network_without_compression_has_no_halves():
    network = SimpleNamespace(codec=NoCompression({}, 32), warp=SimpleNamespace(grid=None))
    with pytest.raises(ConfigError, match="no bytes of them"):
        latent_shape(network)
