"""``dataset.json`` survives the disk and refuses what it cannot hold; a scene has one split."""

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest, Scene, read_manifest, write_manifest
from pcdet_avp.datasets.avp.splits import SPLITS, assign_splits
from pcdet_avp.errors import RecordError

SCENES = (Scene("a", "train", ("0", "1")), Scene("b", "test", ("0",)))


def test_a_manifest_survives_the_disk(tmp_path):
    manifest = Manifest(SCENES, complete=False, seed=3, generator={"GENERATE": {"SEED": 3, "X": [1, 2.5]}})
    write_manifest(tmp_path / "new", manifest)
    assert read_manifest(tmp_path / "new") == manifest
    assert [p.name for p in (tmp_path / "new").iterdir()] == [MANIFEST_FILE]
    assert manifest.frame_ids("train") == ["a/0", "a/1"]
    assert manifest.frame_counts == {"train": 2, "val": 0, "test": 1}


def test_a_manifest_that_cannot_be_written_is_one_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match=r"file/dataset.json: cannot be written"):
        write_manifest(tmp_path / "file", Manifest(SCENES))


def test_an_unknown_split_is_refused():
    with pytest.raises(RecordError, match=r"unknown split 'eval'; known: train, val, test"):
        Manifest(SCENES).frame_ids("eval")


WRONG = [
    ("schema_version", 3, r"dataset.json: schema_version: this package reads schema versions 1 and 2, found 3"),
    ("class_names", ["Car", "Tram"], r"class_names: unknown class 'Tram'"),
    ("complete", "yes", r"complete: expected a boolean, found 'yes'"),
    ("scenes", {}, r"scenes: expected a list"),
    ("scenes", [{"name": "a", "split": "eval", "frames": []}], r"scenes\[0\].split: expected one of train, val, test"),
    ("scenes", [{"name": "a", "split": "test"}], r"scenes\[0\].frames: missing"),
    ("scenes", [{"name": "a", "split": "test", "frames": ["1", "1"]}], r"scenes\[0\].frames: a frame is listed twice"),
    ("scenes", [{"name": "../a", "split": "test", "frames": ["1"]}], r"frame id must be"),
    (
        "scenes",
        [{"name": "a", "split": s, "frames": []} for s in ("train", "test")],
        r"scenes\[1\].name: scene 'a' is listed twice; a scene belongs to one split",
    ),
]


@pytest.mark.parametrize(("field", "value", "message"), WRONG)
def test_a_wrong_field_is_named(tmp_path, field, value, message):
    write_manifest(tmp_path, Manifest(SCENES))
    content = json.loads((tmp_path / MANIFEST_FILE).read_text())
    (tmp_path / MANIFEST_FILE).write_text(json.dumps({**content, field: value}))
    with pytest.raises(RecordError, match=message):
        read_manifest(tmp_path)


def test_a_folder_without_a_manifest_is_no_data_set(tmp_path):
    with pytest.raises(RecordError, match=r"dataset.json: no such file"):
        read_manifest(tmp_path)


def test_the_papers_224_scenes_are_split_80_20_with_a_tenth_for_validation():
    splits = assign_splits([f"{i:04d}" for i in range(224)], seed=0)
    assert Counter(splits.values()) == {"train": 161, "val": 18, "test": 45}


@given(count=st.integers(0, 60), seed=st.integers(0, 99))
def test_every_scene_has_one_split_whatever_the_order_of_the_names(count, seed):
    names = [f"s{i}" for i in range(count)]
    splits = assign_splits(names, seed)
    assert set(splits) == set(names)
    assert splits == assign_splits(reversed(names), seed)
    if count >= 3:
        assert set(splits.values()) == set(SPLITS)


def test_another_seed_splits_otherwise():
    names = [str(i) for i in range(50)]
    assert assign_splits(names, 1) != assign_splits(names, 2)


def test_a_scene_listed_twice_is_refused():
    with pytest.raises(RecordError, match=r"listed twice: \['a'\]"):
        assign_splits(["a", "b", "a"], 0)


@given(count=st.integers(3, 60), test=st.sampled_from([0.0, 0.2]), val=st.sampled_from([0.0, 0.1]))
def test_a_share_of_nothing_gets_no_scene_and_any_other_at_least_one(count, test, val):
    found = Counter(assign_splits([str(i) for i in range(count)], 0, test, val).values())
    assert (found["test"] > 0, found["val"] > 0) == (test > 0, val > 0)
    assert found["train"] > 0
