"""What a study computes of a frame is what the network computes of it when it runs as a whole."""

import zlib

import numpy as np
import pytest
import torch

from pcdet_avp.bandwidth.frame_runner import FrameRunner
from pcdet_avp.bandwidth.late_fusion import Boxes, in_roadside_range, merge
from pcdet_avp.bandwidth.plan import STUDIES, make_plan
from pcdet_avp.bandwidth.transmit import unsparsified
from pcdet_avp.link import MapStamp, encode
from pcdet_avp.models.compression import BevCodec
from pcdet_avp.models.compression.wire import Wire
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose

COMBOS = ("C+C", "CL+CL")
BUDGET = 1125


@pytest.fixture(scope="module")
def points():
    return make_plan(STUDIES, "float16", BUDGET)


@pytest.fixture(scope="module")
def result(network, batch_of, points):
    return FrameRunner(network, points, COMBOS, mcs=7, seed=0, class_names=("Car", "Pedestrian"))(batch_of(0, "CL+CL"))


def direct(network, batch, **how):
    with torch.no_grad():
        found = network(batch, **how)[0][0]
    return Boxes(found["pred_boxes"], found["pred_scores"], found["pred_labels"])


def same(ours, theirs):
    return all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.mark.parametrize("combo", COMBOS)
def test_the_references_are_the_network_itself(network, batch_of, result, combo):
    whole = direct(network, batch_of(0, combo))
    alone = direct(network, batch_of(0, combo.split("+")[0] + "+none"))
    assert len(whole.scores) > 5
    assert not same(whole, alone)
    assert same(result.found[combo, "float16, as trained"], whole)
    assert same(result.found[combo, "vehicle alone"], alone)


@pytest.mark.parametrize("combo", COMBOS)
def test_with_all_blocks_lost_the_vehicle_is_alone(result, combo):
    assert same(result.found[combo, "100 % lost"], result.found[combo, "vehicle alone"])
    assert not same(result.found[combo, "50 % lost"], result.found[combo, "vehicle alone"])


def test_an_erring_vehicle_sees_what_the_network_makes_of_the_wrong_pose(network, batch_of, result):
    batch = batch_of(0, "CL+CL")
    found = result.found["CL+CL", "1 m"]
    rng = np.random.default_rng([0, zlib.crc32(str(batch["frame_id"][0]).encode()), 1])
    x, y, _ = rng.standard_normal(3)
    pose = Pose.from_xyz_yaw(x, y) @ Pose(batch["ego_from_infra"][0].double().numpy())
    expected = direct(network, {**batch, "ego_from_infra": torch.tensor(pose.matrix).float()[None]})
    torch.testing.assert_close(found.scores, expected.scores, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.boxes, expected.boxes, atol=1e-3, rtol=1e-3)
    assert not same(found, result.found["CL+CL", "float16, as trained"])


@pytest.mark.parametrize(("combo", "present"), [("CL+CL", [0, 0, 1, 1]), ("C+C", [0, 0, 1, 0])])
def test_late_fusion_merges_the_roadsides_list_and_the_vehicles(network, batch_of, result, combo, present):
    """Against the network itself, run with the maps of the combination's roadside sensors alone."""
    pose = Pose(batch_of(0, combo)["ego_from_infra"][0].double().numpy())
    batch = batch_of(0, combo)
    batch["source_present"] = batch["source_present"].new_tensor([present])
    roadside = in_roadside_range(direct(network, batch), pose.matrix, network.warp.grid)
    assert len(roadside.scores) > 5
    alone = result.found[combo, "vehicle alone"]
    assert same(result.found[combo, "boxes, not quantised"], merge(alone, roadside, network.post_processing))
    sent = transform_boxes(pose.inverse(), roadside.boxes.double().numpy())
    np.testing.assert_allclose(result.roadside[combo].boxes, sent, atol=1e-4)
    assert torch.equal(result.roadside[combo].scores, roadside.scores)


def test_the_message_moves_late_fusions_boxes_by_steps_alone(network, result, points):
    """What comes out of the message lies within half a step of what went in, turned into the vehicle's frame."""
    raw, coded = (result.found["CL+CL", label] for label in ("boxes, not quantised", "boxes (late fusion)"))
    assert not same(raw, coded)
    alone = {tuple(box) for box in result.found["CL+CL", "vehicle alone"].boxes.tolist()}
    received = [box for box in coded.boxes.double().numpy() if tuple(box.tolist()) not in alone]
    assert received
    for box in received:
        nearest = raw.boxes.double().numpy()[np.linalg.norm(raw.boxes.numpy() - box, axis=1).argmin()]
        assert np.linalg.norm(box[:2] - nearest[:2]) <= 0.005 * 2**0.5 + 1e-4
        assert abs(box[2] - nearest[2]) <= 0.005 + 1e-4
        assert np.abs(box[3:6] - nearest[3:6]).max() <= 0.05 + 1e-4


def test_bytes_are_those_of_the_wire(network, batch_of, result):
    wire = Wire(network.codec, max_segment_bytes=674)
    direct(network, batch_of(0, "CL+CL"), link=wire)
    sent = result.sent["float16, as trained"]
    assert {f"infra_{m}": sizes for m, sizes in wire.take_sizes().items()} == {s: [x.bytes] for s, x in sent.items()}
    assert result.blocks[7] == {source: numbers.blocks for source, numbers in sent.items()}
    assert result.blocks[28]["infra_lidar"] <= result.blocks[7]["infra_lidar"]


def test_every_budget_holds(result):
    for part in (1, 2, 4, 8):
        for precision in ("float16", "int8"):
            sent = result.sent[f"{precision}, {BUDGET // part} B"].values()
            assert all(numbers.bytes <= BUDGET // part for numbers in sent)
    sparse, dense = (result.sent[f"float16, {BUDGET // part} B"]["infra_lidar"] for part in (8, 1))
    assert 0 < sparse.occupied < dense.occupied < 1


def test_what_is_not_thinned_is_what_the_compressor_sends_where_it_may_send_all():
    """Against a codec whose threshold lets every cell pass: only rounding lies between."""
    torch.manual_seed(0)
    codec = BevCodec({"THRESHOLD": "rate", "TARGET_SHARE": 1.0}, channels=16).codecs["camera"]
    x = torch.randn(1, 16, 12, 10)
    with torch.no_grad():
        ours, theirs = unsparsified(codec, x), codec.compress(x)[0]
    assert torch.equal(ours.half().float(), theirs)
    assert not torch.equal(ours, theirs)


def test_the_air_carries_what_encode_says(result):
    """An empty map of this shape is all header: no map is smaller."""
    nothing = encode(np.zeros((2, 47, 35), np.float32), MapStamp(0, 0, "camera", 0, 0, 0), 674)
    assert all(x.bytes > sum(map(len, nothing)) for x in result.sent["float16, as trained"].values())
