"""Which frames are taken, what is compared with what, and what survives a kill."""

from types import SimpleNamespace

import pytest
import torch

from pcdet_avp.bandwidth import ages
from pcdet_avp.bandwidth.ages import PERIOD_S, age_rows
from pcdet_avp.bandwidth.frame_runner import FrameResult
from pcdet_avp.bandwidth.parts import Parts, key_of
from pcdet_avp.bandwidth.plan import STUDIES, Transmission, make_plan, paper_budget_bytes
from pcdet_avp.bandwidth.rows import held_against
from pcdet_avp.bandwidth.study import StudyOptions, check_message_classes, choose_frames, precision_of
from pcdet_avp.bandwidth.transmit import Sent, segments_of, sent_of
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, write_manifest
from pcdet_avp.errors import ConfigError
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.models.compression import NoCompression


def test_every_second_frame_of_each_scene():
    ids = [f"{scene}/{frame}" for scene in "ab" for frame in range(5)]
    assert choose_frames(ids, 2, None) == [0, 2, 4, 5, 7, 9]
    assert choose_frames(ids, 2, 4) == [0, 2, 4, 5]
    assert choose_frames(ids, 9, None) == [0, 5]


def test_the_papers_budget_at_its_own_size_is_72_kb():
    assert paper_budget_bytes((8, 188, 140)) == 72_000
    assert paper_budget_bytes((4, 94, 70)) == 9_000  # cp_small


def test_labels_are_unique_and_held_against_the_right_one():
    points = make_plan(STUDIES, "int8", 9000)
    assert len({p.label for p in points}) == len(points)
    against = {p.label: held_against(points, p) for p in points}
    assert against["vehicle alone"] is against["not thinned, not rounded"] is None
    assert against["int8, as trained"] == against["float16, 1125 B"] == "not thinned, not rounded"
    assert against["5 % lost"] == against["0.5 m"] == against["boxes (late fusion)"] == "int8, as trained"
    assert against["boxes, not quantised"] == "int8, as trained"
    few = make_plan(["budget"], "int8", 9000)
    assert held_against(few, few[2]) == "int8, as trained"
    assert held_against(few, few[1]) is None


def test_a_limit_on_bytes_holds_for_all_but_what_is_studied_without_it():
    block = MapSize(1475, constant=True)
    points = {p.label: p for p in make_plan(STUDIES, "int8", 9000, block)}
    for label in ("int8, as trained", "5 % lost", "0.5 m"):
        assert points[label].transmission.size == block
    assert points["int8, no limit on bytes"].transmission == Transmission("int8")
    assert held_against(list(points.values()), points["int8, as trained"]) == "not thinned, not rounded"
    assert points["int8, 1125 B"].transmission.size == MapSize(1125)
    assert "int8, no limit on bytes" not in {p.label for p in make_plan(STUDIES, "int8", 9000)}


def test_padding_is_counted():
    latent = torch.zeros(4, 12, 10)
    latent[:, 3, 4] = 1.0
    sizes = {}
    for size in (UNLIMITED, MapSize(1475), MapSize(1475, constant=True)):
        sent = sent_of(segments_of(latent, "lidar", Transmission("int8", size=size), 1475))
        assert (sent.blocks, sent.occupied) == (1, pytest.approx(1 / 120))
        sizes[size] = sent.bytes
    assert sizes[UNLIMITED] == sizes[MapSize(1475)] < 80
    assert sizes[MapSize(1475, constant=True)] == 1475


@pytest.mark.parametrize("options", [{"every": 0}, {"frames": 0}, {"combos": ("CL+none",)}])
def test_what_cannot_be_studied_is_refused(options):
    with pytest.raises(ConfigError, match="--"):
        StudyOptions(**{"studies": STUDIES, "combos": ("CL+CL",)} | options)


def test_unknown_studies_are_named():
    with pytest.raises(ConfigError, match=r"expected some of codec, .*, found rain"):
        make_plan(["rain"], "float16", 9000)


def test_classes_without_a_code_in_the_message_are_refused_before_the_work():
    points = make_plan(["objects"], "float16", 9000)
    check_message_classes(points, ["Car", "Pedestrian", "Cyclist"])
    with pytest.raises(ConfigError, match=r"--studies: .*found Tram; leave out 'objects'"):
        check_message_classes(points, ["Car", "Tram"])
    check_message_classes(make_plan(["loss"], "float16", 9000), ["Tram"])


def test_a_frame_on_disk_is_the_frame_and_a_torn_one_is_none(tmp_path, boxes_of):
    parts = Parts(tmp_path / "frames", ["C+CL"], ["a", "b"])
    found = {("C+CL", "a"): boxes_of((10, 0, 0.6, 1), (20, 1 / 3, 0.1, 2)), ("C+CL", "b"): boxes_of()}
    sent = {"a": {"infra_lidar": Sent(1000, 2, 0.125)}}
    assert parts.load("0000/001") is None
    parts.save("0000/001", FrameResult(found, {"C+CL": boxes_of((5, 5, 0.5, 1))}, sent, {7: {"infra_lidar": 3}}))
    loaded = parts.load("0000/001")
    assert loaded.sent == sent
    assert loaded.blocks == {7: {"infra_lidar": 3}}
    for key, boxes in found.items():
        assert all(torch.equal(a, b) for a, b in zip(boxes, loaded.found[key], strict=True))
    assert loaded.roadside["C+CL"].scores.tolist() == [0.5]
    (file,) = (tmp_path / "frames").iterdir()
    file.write_bytes(file.read_bytes()[:-40])
    assert parts.load("0000/001") is None


def test_frames_whose_names_differ_only_in_where_the_slash_is_do_not_share_a_file(tmp_path, boxes_of):
    parts = Parts(tmp_path, ["C+CL"], ["a"])
    for frame_id, score in (("lot_a/1", 0.25), ("lot/a_1", 0.5)):
        parts.save(frame_id, FrameResult({("C+CL", "a"): boxes_of((1, 2, score, 1))}, {"C+CL": boxes_of()}, {}, {}))
    assert parts.load("lot_a/1").found["C+CL", "a"].scores.tolist() == [0.25]


def test_frames_of_another_data_set_are_computed_anew(tmp_path):
    """What a configuration's hash does not tell: DATA_PATH, and the seed that tools/create_data.py was given."""
    cfg, keys = {"DATA_CONFIG": {"DATA_PATH": "anywhere"}}, []
    for seed in (1, 1, 2):
        write_manifest(tmp_path / str(seed), Manifest((Scene("0000", "test", ("000",)),), seed=seed))
        keys.append(key_of(cfg, tmp_path / str(seed), "weights", ("C+CL",)))
    assert keys[0] == keys[1] != keys[2]
    assert (
        key_of(cfg, tmp_path / "1", "weights", ("CL+CL",)) != keys[0] != key_of({}, tmp_path / "1", "other", ("C+CL",))
    )


def test_age_without_loss_is_half_a_period_and_the_air_time():
    """Camera maps of 4 blocks (2 ms) go first, LiDAR maps of 6 blocks (3 ms) wait for them."""
    rows = {(r.modality, r.loss): r for r in age_rows({21: {"camera": [4], "lidar": [6]}}, seed=0)}
    for modality, air_s in (("camera", 0.002), ("lidar", 0.005)):
        row = rows[modality, 0.0]
        assert row.mean_age_s == pytest.approx(PERIOD_S / 2 + air_s)
        assert row.closed_form_s == pytest.approx(PERIOD_S / 2 + air_s)
        assert row.whole_maps == pytest.approx(1, abs=1e-3)
        assert row.air_busy == pytest.approx(10 * 0.0005 / PERIOD_S, rel=1e-3)
        lossy = rows[modality, 0.05]
        assert lossy.mean_age_s == pytest.approx(lossy.closed_form_s, rel=0.05)
        assert lossy.whole_maps == pytest.approx(0.95 ** (4 if modality == "camera" else 6), abs=0.03)


def test_maps_of_which_hardly_one_arrives_whole_have_no_age(monkeypatch):
    monkeypatch.setattr(ages, "MAPS", 40)
    hopeless = age_rows({7: {"camera": [90]}}, seed=0)[-1]
    assert (hopeless.loss, hopeless.whole_maps) == (0.2, 0)  # 0.8 ** 90 is 2e-9
    assert hopeless.mean_age_s is hopeless.p95_age_at_ticks_s is None


def test_a_network_without_compression_has_nothing_to_report():
    with pytest.raises(ConfigError, match=r"bandwidth report: .*no bytes"):
        precision_of(SimpleNamespace(codec=NoCompression({}, 32)))
