"""Both halves without torch, beside those in torch, on generated frames."""

import copy
from argparse import Namespace

import numpy as np
import pytest
import torch

from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.deploy.runtime import open_runtime
from pcdet_avp.engine.halves import open_roadside
from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.link import MapStamp, Receiver, decode
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.models.compression.map_packets import MapPacker, to_segments
from pcdet_avp.models.detectors.split_inference import RoadsideHalf, VehicleHalf
from pcdet_avp.models.export.opened import open_deployed
from pcdet_avp.structures.sensor_set import INFRA_SOURCES, SensorSet

SEGMENT_BYTES = 400
LARGEST_DIFFERENCE = 0.01  # of a latent's value, ours: the design document's


@pytest.fixture(scope="module", params=["onnxruntime", "openvino"])
def deployed(request, to_export, exported):
    pytest.importorskip(request.param, reason=f"needs {request.param}: pip install 'pcdet_avp[deploy]'")
    return open_deployed(exported, request.param, to_export.cfg, threads=1)


@pytest.fixture(scope="module")
def halves(deployed):
    """Roadside and vehicle without torch."""
    return deployed.roadside(SEGMENT_BYTES), deployed.vehicle()


@pytest.fixture(scope="module")
def in_torch(to_export):
    return RoadsideHalf(to_export.network, SEGMENT_BYTES), VehicleHalf(to_export.network)


def sample_of(frame, to_export, combo="CL+CL"):
    return prepare(frame, SensorSet.parse(combo), to_export.dataset.prepare_config)


def test_the_same_map_gives_torchs_bytes(to_export, exported, frames):
    pytest.importorskip("onnxruntime")
    half = open_deployed(exported, "onnxruntime", to_export.cfg, threads=2).roadside(SEGMENT_BYTES)
    batch, sent = load_batch(collate([sample_of(frames[0], to_export)]), "cpu"), 0
    with torch.no_grad():
        encoded = to_export.network.encode(batch, INFRA_SOURCES)
        latents = to_export.network.codec.compress(encoded)["latents"]
    for source, latent in latents.items():
        stamp = MapStamp(7, 350_000, source.removeprefix("infra_"), 1.0, 2.0, 0.5)
        ours = half.pack(half.compress(encoded["bev_maps"][source].numpy(), source), stamp)
        theirs = to_segments(latent.values[0], stamp, SEGMENT_BYTES, "float16")
        assert ours == theirs
        sent += int((latent.values != 0).sum())
    assert sent > 100


def test_a_limit_on_bytes_is_the_configurations_and_holds_as_in_torch(to_export, exported, monkeypatch):
    pytest.importorskip("onnxruntime")
    cfg, size = copy.deepcopy(to_export.cfg), MapSize(300, constant=True)
    cfg.MODEL.COMPRESSION.update(MAX_BYTES=300, CONSTANT_SIZE=True)
    deployed = open_deployed(exported, "onnxruntime", cfg, threads=1)
    assert deployed.exported.network.map_size == UNLIMITED
    monkeypatch.setattr(to_export.network.codec, "map_size", size)
    stamp, latent = MapStamp(7, 0, "lidar", 0.0, 0.0, 0.0), torch.randn(*deployed.exported.network.latent_shape)
    for budget, expected in ((None, 300), (72_000, 300), (200, 200)):
        (ours,) = deployed.roadside(SEGMENT_BYTES, budget).pack(latent.numpy(), stamp)
        (theirs,) = MapPacker(to_export.network.codec, SEGMENT_BYTES, "a test", budget).pack(latent, stamp)
        assert ours == theirs
        assert len(ours) == expected
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES of 299 or less"):
        deployed.roadside(299)
    cfg.MODEL.COMPRESSION.CONSTANT_SIZE = False
    unit = {"X_M": 0.0, "Y_M": 0.0, "Z_M": 5.0, "YAW_DEG": 0.0, "PITCH_DOWN_DEG": 30.0}
    for units, least in ((None, 47), ([unit, unit], 49)):  # the second unit says its number in two bytes
        cfg.DATA_CONFIG.ROADSIDE_UNITS, cfg.MODEL.COMPRESSION.MAX_BYTES = units, least - 1
        with pytest.raises(ConfigError, match=rf"MAX_BYTES: expected {least} or more, .*found {least - 1}"):
            open_deployed(exported, "onnxruntime", cfg, threads=1)
    cfg.DATA_CONFIG.ROADSIDE_UNITS, cfg.MODEL.COMPRESSION.MAX_BYTES = None, 56
    args = Namespace(runtime="onnxruntime", exported=exported)  # a unit in service names its network, too
    with pytest.raises(ConfigError, match=r"MAX_BYTES: expected 57 or more, .*which network made it, found 56"):
        open_roadside(args, cfg, SEGMENT_BYTES, 72_000)


def test_the_whole_roadside_half_sends_nearly_torchs_map(to_export, halves, in_torch, frames):
    for frame in frames:
        sample, pose = sample_of(frame, to_export), frame.infra.world_from_agent
        ours = halves[0].segments(sample, 1, 50_000, pose)
        theirs = in_torch[0].segments(load_batch(collate([sample]), "cpu"), 1, 50_000, pose)
        assert set(ours) == set(theirs) == set(INFRA_SOURCES)
        for source in ours:
            ours_map, theirs_map = decode(ours[source]), decode(theirs[source])
            assert ours_map.stamp == theirs_map.stamp
            assert np.abs(ours_map.values - theirs_map.values).max() <= LARGEST_DIFFERENCE
            sizes = [sum(map(len, one[source])) for one in (ours, theirs)]
            assert abs(sizes[0] - sizes[1]) <= 0.02 * sizes[1]


@pytest.mark.parametrize("combo", ["C+none", "CL+none", "C+CL", "CL+CL"])
def test_detections_are_near_torchs(to_export, halves, in_torch, frames, combo):
    for frame in frames:
        sample, pose = sample_of(frame, to_export, combo), frame.ego.world_from_agent
        batch = load_batch(collate([sample]), "cpu")
        sent = in_torch[0].segments(batch, 1, 0, frame.infra.world_from_agent) if "none" not in combo else {}
        maps = [decode(segments) for segments in sent.values()]
        theirs = {key: value.numpy() for key, value in in_torch[1].detect(batch, pose, maps).items()}
        ours = halves[1].detect(sample, pose, maps)
        strong = theirs["pred_scores"] > np.median(theirs["pred_scores"])
        assert strong.sum() >= 10
        for box, score, label in zip(
            *(theirs[key][strong] for key in ("pred_boxes", "pred_scores", "pred_labels")), strict=True
        ):
            same = ours["pred_labels"] == label
            off = np.abs(ours["pred_boxes"][same] - box)[:, :6].max(1)
            assert off.min() < 0.01
            assert abs(ours["pred_scores"][same][off.argmin()] - score) < 0.005


def test_packets_name_the_network_that_was_exported_once_they_are_to(to_export, deployed, frames):
    sample = sample_of(frames[0], to_export)
    half, pose = deployed.roadside(SEGMENT_BYTES), frames[0].infra.world_from_agent
    assert {decode(s).stamp.network for s in half.segments(sample, 1, 0, pose).values()} == {0}
    half.network_number = deployed.exported.network_number
    assert half.network_number == 0x0123  # the fixture's weights_hash
    assert {decode(s).stamp.network for s in half.segments(sample, 1, 0, pose).values()} == {0x0123}
    theirs = RoadsideHalf(to_export.network, SEGMENT_BYTES)
    theirs.network_number = 0x0123
    sent = theirs.segments(load_batch(collate([sample]), "cpu"), 1, 0, pose)
    assert {decode(s).stamp.network for s in sent.values()} == {0x0123}


def test_a_lossy_link_ends_in_torchs_boxes_too(to_export, halves, in_torch, frames):
    frame, sample = frames[0], sample_of(frames[0], to_export)
    batch, pose = load_batch(collate([sample]), "cpu"), frames[0].ego.world_from_agent
    receiver = Receiver(halves[1].shape)
    for source, segments in halves[0].segments(sample, 1, 0, frame.infra.world_from_agent).items():
        for payload in segments[::2] if source == "infra_lidar" else segments:
            receiver.push(payload)
    maps = [known for name in ("camera", "lidar") if (known := receiver.take(name, 0)) is not None]
    assert any(not known.present.all() for known in maps)
    raw = in_torch[1].run(batch, pose, maps)["batch_cls_preds"].numpy()
    received = {f"infra_{known.stamp.modality}": known for known in maps}
    assert halves[1].shape == in_torch[1].shape
    outputs = _run(halves[1], sample, pose, received)
    np.testing.assert_allclose(outputs["cls_preds"], raw, atol=0.02)


def _run(half, sample, world_from_ego, received):
    from pcdet_avp.deploy.halves import Received

    ego_from_world = world_from_ego.inverse()
    placed = {
        source: Received(known.values, known.present, (ego_from_world @ known.stamp.world_from_agent).matrix)
        for source, known in received.items()
    }
    return half.run(sample, placed)


def test_an_empty_cloud_is_a_map_of_no_points(to_export, halves, in_torch, frames):
    sample = sample_of(frames[0], to_export) | {"points_infra": np.zeros((0, 4), np.float32)}
    batch = load_batch(collate([sample]), "cpu")
    with torch.no_grad():
        expected = to_export.network.encode_roadside(batch)["infra_lidar"].values[0].numpy()
    np.testing.assert_allclose(halves[0].latents(sample)["infra_lidar"], expected, atol=LARGEST_DIFFERENCE)


def test_without_any_sensor_there_is_nothing_to_fuse(to_export, halves, frames):
    sample = sample_of(frames[0], to_export, "C+none") | {"source_present": np.zeros(4, bool)}
    with pytest.raises(SensorError, match="no feature map from any of the four sources"):
        halves[1].detect(sample, frames[0].ego.world_from_agent, [])


def test_threads_change_no_answer(to_export, exported, frames):
    pytest.importorskip("onnxruntime")
    sample = sample_of(frames[0], to_export)
    found = [open_deployed(exported, "onnxruntime", to_export.cfg, threads=n).roadside(400) for n in (1, 4)]
    one, four = (half.latents(sample)["infra_lidar"] for half in found)
    for _ in range(5):  # what races shows up now and then
        np.testing.assert_allclose(four, one, atol=LARGEST_DIFFERENCE)
        four = found[1].latents(sample)["infra_lidar"]


def test_a_runtime_is_opened_with_the_threads_that_the_environment_allows(monkeypatch):
    pytest.importorskip("onnxruntime")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert open_runtime("onnxruntime")._threads == 3
