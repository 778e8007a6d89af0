"""tools/test.py as a user meets it."""

import json
import shutil

import pytest

from pcdet_avp.errors import CheckpointError, ConfigError, OutputError, SensorError
from pcdet_avp.evaluation.detections_file import read_detections
from pcdet_avp.structures.sensor_set import SENSOR_SETS

COLUMNS = {"easy", "hard", "overall"}


@pytest.fixture(scope="module")
def results(call, trained, tmp_path_factory):
    """Results of the trained network: as training left them, without bytes, and with bytes on the wire."""
    folder, ckpt = tmp_path_factory.mktemp("tested"), trained / "ckpt" / "checkpoint_epoch_2.pth"
    call(folder, "test", "--ckpt", ckpt, "--json", folder / "wire.json", "--wire")
    files = (trained / "eval" / "checkpoint_epoch_2" / "test" / "result.json", folder / "wire.json")
    return [json.loads(file.read_text()) for file in files]


def test_the_json_file_has_the_documented_form(results):
    for content in results:
        assert [row["combo"] for row in content["rows"] if row["region"] == "camera_fov"] == list(SENSOR_SETS)
        for row in content["rows"]:
            assert row["region"] in ("camera_fov", "full_range")
            assert set(row["Car"]) == set(row["Pedestrian"]) == COLUMNS
            assert all({"0.7", "0.01"} <= set(cell) for cell in row["Car"].values())
            assert all({"0.3", "0.01"} <= set(cell) for cell in row["Pedestrian"].values())
    assert all(row["bytes_per_map"] == {"camera": None, "lidar": None} for row in results[0]["rows"])


def test_the_json_file_says_where_it_comes_from(results):
    meta = results[1]["meta"]
    assert (meta["config"], meta["split"], meta["frames"], meta["seed"]) == ("cp_tiny", "test", 1, 0)
    assert meta["split_by"] == "scene"
    assert len(meta["weights_hash"]) == len(meta["config_hash"]) == 16
    assert set(meta["score_thresholds"]) == {"Car", "Pedestrian"}
    assert meta["wall_time_s"] > 0


def test_the_wire_changes_the_bytes_and_nothing_else(results):
    plain, wired = results
    for ours, theirs in zip(wired["rows"], plain["rows"], strict=True):
        sent = {"camera": "+C" in ours["combo"], "lidar": "+CL" in ours["combo"]}
        assert {modality: size is not None for modality, size in ours["bytes_per_map"].items()} == sent
        assert {**ours, "bytes_per_map": None} == {**theirs, "bytes_per_map": None}


def test_some_combinations_on_another_split_print_their_rows(call, trained, capsys):
    call(trained.parents[3], "test", "--combos", "CL+CL,C+none", "--split", "val")
    printed = capsys.readouterr().out
    assert "Split 'val', by scene:" in printed
    assert printed.count("| ours ") == printed.count("| paper ") == 4
    assert (trained / "eval" / "checkpoint_epoch_2" / "val" / "default" / "result.json").exists()


def test_a_json_file_that_cannot_be_written_is_said_before_anything_is_tested(call, tmp_path):
    with pytest.raises(OutputError, match=r"cannot write this file \(Is a directory\)"):
        call(tmp_path, "test", "--ckpt", "no_such.pth", "--json", tmp_path)


def test_detections_are_kept_as_arrays_and_as_texts(call, trained, tmp_path):
    """The arrays are OpenPCDet's result.pkl without pickle; --save_to_file adds a text per frame."""
    ckpt = trained / "ckpt" / "checkpoint_epoch_2.pth"
    call(tmp_path, "test", "--ckpt", ckpt, "--combos", "C+none,CL+CL", "--save_to_file", "--eval_tag", "kept")
    folder = tmp_path / "output" / "avp" / "cp_tiny" / "default" / "eval" / ckpt.stem / "test" / "kept"
    for combo in ("C+none", "CL+CL"):
        kept = read_detections(folder / "detections" / f"{combo}.npz")
        texts = sorted((folder / "final_result" / combo).glob("*.txt"))
        assert [len(text.read_text().splitlines()) for text in texts] == [len(d.boxes) for d in kept]
        assert len(kept) == 1
        assert kept[0].boxes.size


def test_a_second_test_under_the_same_tag_leaves_nothing_of_the_first(call, trained, tmp_path):
    """Their weights may differ: the first one's detections would pass for those of the result beside them."""
    words = ("test", "--ckpt", trained / "ckpt" / "checkpoint_epoch_2.pth", "--eval_tag", "twice")
    folder = tmp_path / "output/avp/cp_tiny/default/eval/checkpoint_epoch_2/test/twice"
    call(tmp_path, *words, "--combos", "C+none,CL+CL", "--save_to_file")
    (folder / "notes.txt").write_text("the user's")
    call(tmp_path, *words, "--combos", "C+none")
    left = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert left == {"table.md", "details.md", "result.json", "detections/C+none.npz", "notes.txt"}


def test_another_runs_checkpoint_of_the_same_name_has_a_folder_of_its_own(call, trained, tmp_path):
    other = tmp_path / "checkpoint_epoch_2.pth"
    shutil.copy(trained / "ckpt" / other.name, other)
    before = (trained / "eval" / "checkpoint_epoch_2" / "test" / "result.json").read_bytes()
    call(trained.parents[3], "test", "--ckpt", other, "--combos", "C+none")
    assert (trained / "eval" / "checkpoint_epoch_2" / "test" / "result.json").read_bytes() == before
    (folder,) = (trained / "eval").glob("checkpoint_epoch_2_*")
    result = json.loads((folder / "test" / "default" / "result.json").read_text())
    assert folder.name == f"checkpoint_epoch_2_{result['meta']['weights_hash']}"


def test_every_checkpoint_of_a_run_gives_a_curve(call, trained):
    call(trained.parents[3], "test", "--eval_all", "--combos", "C+none")
    assert all((trained / "eval" / f"checkpoint_epoch_{n}" / "val").exists() for n in (1, 2))
    assert list((trained / "eval" / "tensorboard").iterdir())


def test_weights_of_another_configuration_are_named_by_the_first_difference(call, trained, tmp_path):
    ckpt = trained / "ckpt" / "checkpoint_epoch_2.pth"
    with pytest.raises(CheckpointError, match=r"MODEL\.NUM_BEV_FEATURES is 16 in the file and 32 here"):
        call(tmp_path, "test", "--ckpt", ckpt, overrides=["MODEL.NUM_BEV_FEATURES", 32])


def test_what_does_not_exist_is_said_so(call, trained, tmp_path):
    with pytest.raises(ConfigError, match="no checkpoint there; name one with --ckpt"):
        call(tmp_path, "test")
    with pytest.raises(SensorError, match="unknown sensor combination 'L'"):
        call(tmp_path, "test", "--combos", "L")
    with pytest.raises(CheckpointError, match=r"none\.pth: cannot read"):
        call(tmp_path, "test", "--ckpt", tmp_path / "none.pth")


def test_frames_that_the_weights_were_trained_on_by_the_other_protocol_are_not_tested_on(call, trained, tmp_path):
    ckpt = trained / "ckpt" / "checkpoint_epoch_2.pth"
    for tool, given in (("test", "--ckpt"), ("train", "--pretrained_model")):
        with pytest.raises(CheckpointError, match=r"trained on these data with DATA_CONFIG\.SPLIT_BY 'scene'"):
            call(tmp_path, tool, given, ckpt, overrides=["DATA_CONFIG.SPLIT_BY", "frame"])
