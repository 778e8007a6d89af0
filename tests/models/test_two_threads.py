"""A frame on two threads: the same maps, packets and detections as on one, and only anchors that anybody would see."""

import pytest
import torch

from pcdet_avp.models.side_by_side import cores
from tests.models.test_configured_networks import make_batch, network_of

SHAPE = (270, 480)


@pytest.fixture(scope="module")
def network():
    built, _ = network_of("cp_small.yaml")
    torch.nn.init.constant_(built.dense_head.conv_cls.bias, -0.6)  # so that some anchors are above their thresholds
    torch.nn.init.normal_(built.dense_head.conv_cls.weight, std=0.3)
    return built.eval().requires_grad_(False)


@pytest.fixture(params=[1, 2])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def halves(network, batch, precision):
    network.precision = precision
    with torch.inference_mode():
        latents = network.encode_roadside(batch)
        return latents, network.detect(network.encode_vehicle({**batch, "latents": latents}))[0]


def on(threads, network, batch, precision):
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        assert cores() == threads
        return halves(network, batch, precision)
    finally:
        torch.set_num_threads(before)


def test_two_threads_change_nothing(network):
    """But what torch's convolutions round."""
    batch = make_batch(["CL+CL"], SHAPE)
    (latents, detections), (expected, one) = (on(threads, network, batch, "float32") for threads in (2, 1))
    for source, latent in expected.items():
        assert torch.equal(latents[source].received, latent.received)
        torch.testing.assert_close(latents[source].values, latent.values, atol=1e-3, rtol=1e-3)
    assert torch.equal(latents["infra_lidar"].values, expected["infra_lidar"].values)
    assert len(detections["pred_scores"]) == len(one["pred_scores"]) > 5
    torch.testing.assert_close(detections["pred_scores"], one["pred_scores"], atol=1e-3, rtol=0)


@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_the_same_frame_gives_the_same_bits_whichever_thread_is_faster(network, precision):
    batch = make_batch(["CL+CL"], SHAPE)
    (latents, detections), *again = (on(2, network, batch, precision) for _ in range(4))
    for other_latents, other_detections in again:
        for source, latent in latents.items():
            assert torch.equal(latent.values, other_latents[source].values)
        for name, value in detections.items():
            assert torch.equal(value, other_detections[name]), name


def test_anchors_that_nobody_would_see_change_no_detection(network, threads):
    batch = make_batch(["CL+CL"], SHAPE)
    with torch.inference_mode():
        everything = network.run_stages(batch)
        expected = network.post_processing(everything)[0][0]
        found = network(batch)[0][0]
    assert everything["batch_box_preds"].shape[1] == len(network.dense_head.anchors)
    assert len(expected["pred_scores"]) > 5
    for name, value in expected.items():
        assert torch.equal(found[name], value), name


def test_without_any_map_received_and_without_any_sensor_of_its_own(network, threads):
    batch = make_batch(["CL+CL"], SHAPE)
    with torch.inference_mode():
        latents = network.encode_roadside(batch)
        alone = network.detect(network.encode_vehicle({**batch, "latents": {}}))[0]
        blind = {**batch, "source_present": torch.zeros(1, 4)}
        only_received = network.detect(network.encode_vehicle({**blind, "latents": latents}))[0]
        apart = network.detect({**network.encode_vehicle(blind), "latents": latents})[0]
    assert set(alone) == set(only_received)
    for name, value in apart.items():
        assert torch.equal(only_received[name], value), name
