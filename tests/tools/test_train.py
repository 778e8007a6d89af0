"""tools/train.py as a user meets it."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from easydict import EasyDict
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from pcdet_avp.datasets.avp.manifest import Manifest, Scene, write_manifest
from pcdet_avp.errors import CheckpointError, ConfigError, RecordError, SensorError
from pcdet_avp.folder_lock import sole_user
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

REPOSITORY = Path(__file__).parents[2]
LAST = "checkpoint_epoch_2.pth"


@pytest.fixture
def workplace(trained, tmp_path):
    """A copy of the trained run, to go on from; the new run's folder."""
    run = tmp_path / "output" / "avp" / "cp_tiny" / "default"
    shutil.copytree(trained, run)
    return tmp_path, run


def _log(run):
    return "".join(file.read_text() for file in sorted(run.glob("train_*.log")))


def test_a_run_leaves_checkpoints_curves_pictures_a_log_its_configuration_and_a_benchmark(trained):
    assert (trained / "ckpt" / "checkpoint_epoch_1.pth").exists()
    assert "NUM_EPOCHS: 2" in (trained / "cp_tiny.yaml").read_text()
    assert "parameters; 4 frames, 2 iterations of 2 an epoch, 4 in all" in _log(trained)
    curves = EventAccumulator(str(trained / "tensorboard")).Reload().Tags()
    assert {"train/loss", "train/rpn_loss_cls", "meta_data/learning_rate", "meta_data/grad_norm"} <= set(
        curves["scalars"]
    )
    assert any(tag.startswith("combination/C") for tag in curves["scalars"])
    assert curves["images"] == ["detections"]
    result = json.loads((trained / "eval" / "checkpoint_epoch_2" / "test" / "result.json").read_text())
    assert len(result["rows"]) == 12
    assert "| paper |" in (trained / "eval" / "checkpoint_epoch_2" / "test" / "table.md").read_text()


def test_the_last_checkpoint_holds_the_scores_to_drive_with_and_where_it_comes_from(trained):
    content = read_checkpoint(trained / "ckpt" / LAST)
    assert set(content["score_thresholds"]) == {"Car", "Pedestrian"}
    assert (content["config_name"], content["it"], content["epoch"]) == ("cp_tiny", 4, 2)
    assert content["config"]["MODEL"]["NAME"] == "AvpCp"


def test_a_finished_run_is_not_trained_again(workplace, call):
    folder, run = workplace
    before = (run / "ckpt" / LAST).read_bytes()
    call(folder, "train", "--epochs", 2, "--no_eval")
    assert "training is complete at iteration 4" in _log(run)
    assert (run / "ckpt" / LAST).read_bytes() == before


def test_more_epochs_go_on_from_where_it_ended(workplace, call):
    folder, run = workplace
    call(folder, "train", "--epochs", 3, "--no_eval")
    assert "going on from" in _log(run)
    assert read_checkpoint(run / "ckpt" / "checkpoint_epoch_3.pth")["it"] == 6


def test_a_run_that_goes_on_says_that_pretrained_weights_were_for_its_start(workplace, call, trained):
    folder, run = workplace
    call(folder, "train", "--epochs", 2, "--no_eval", "--pretrained_model", trained / "ckpt" / "checkpoint_epoch_1.pth")
    assert re.search(rf"going on from .*{LAST}, whose weights take the place of --pretrained_model's: iter", _log(run))


def test_a_truncated_checkpoint_is_named_and_kept_and_the_one_before_used(workplace, call, trained):
    folder, run = workplace
    newest = run / "ckpt" / LAST
    newest.write_bytes(newest.read_bytes()[:-5000])
    call(folder, "train", "--epochs", 2, "--no_eval")
    assert f"{LAST}: truncated" in _log(run)
    assert (run / "ckpt" / f"{LAST}.damaged").exists()
    again, first = (read_checkpoint(place / "ckpt" / LAST)["model_state"] for place in (run, trained))
    assert all(torch.equal(again[key], first[key]) for key in first)


def test_another_configuration_does_not_go_on_with_this_run(workplace, call):
    folder, run = workplace
    before = (run / "cp_tiny.yaml").read_bytes()
    with pytest.raises(CheckpointError, match=r"made with OPTIMIZATION\.LR 0\.003, this run has 0\.002"):
        call(folder, "train", "--epochs", 3, overrides=["OPTIMIZATION.LR", "0.002"])
    with pytest.raises(CheckpointError, match="seed is 0, this one's is 1"):
        call(folder, "train", "--epochs", 3, "--seed", 1)
    assert (run / "cp_tiny.yaml").read_bytes() == before  # the run's configuration, not the refused one


def test_pretrained_weights_start_a_run_of_their_own(call, trained, tmp_path):
    call(tmp_path, "train", "--epochs", 1, "--no_eval", "--pretrained_model", trained / "ckpt" / LAST)
    run = tmp_path / "output" / "avp" / "cp_tiny" / "default"
    assert "loaded" in _log(run)
    content = read_checkpoint(run / "ckpt" / "checkpoint_epoch_1.pth")
    assert content["it"] == 2


@pytest.mark.parametrize("option", ["--ckpt", "--pretrained_model"])
def test_a_misspelt_file_leaves_no_run_behind(option, call, tmp_path):
    with pytest.raises(CheckpointError, match=r"cp_smal\.pth: cannot read .*near ones: weights/cp_small"):
        call(tmp_path, "train", option, "weights/cp_smal.pth", "--extra_tag", "mistyped")
    assert not list(tmp_path.iterdir())


def test_missing_data_are_made_first(load_tool, tiny_data, tmp_path, monkeypatch):
    tool, root, said = load_tool("train"), tmp_path / "data", []
    monkeypatch.setattr(tool, "generate", lambda cfg, root, workers: shutil.copytree(tiny_data, root))
    monkeypatch.setattr(tool, "run_training", lambda cfg, *_: said.append(Path(cfg.DATA_CONFIG.DATA_PATH).exists()))
    monkeypatch.setattr(tool, "open_log", lambda *_: _Listener(said))
    monkeypatch.chdir(tmp_path)
    words = ["train", "--cfg", str(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml"), "--no_eval"]
    monkeypatch.setattr(sys, "argv", [*words, "--set", "DATA_CONFIG.DATA_PATH", str(root)])
    tool.main()
    assert said == [f"no data set in {root}: making it", True]


class _Listener:
    def __init__(self, said):
        self.info = self.warning = said.append


@pytest.mark.parametrize(("name", "slow"), [("cp_full", True), ("cp_small", False)])
def test_the_papers_size_on_a_cpu_saves_memory_and_names_the_small_one(load_tool, monkeypatch, tmp_path, name, slow):
    tool, said, given = load_tool("train"), [], []
    monkeypatch.setattr(tool, "generate", lambda *_, **__: None)
    monkeypatch.setattr(tool, "run_training", lambda *words: given.extend(words))
    monkeypatch.setattr(tool, "open_log", lambda *_: _Listener(said))
    monkeypatch.chdir(tmp_path)
    words = ["train", "--cfg", str(REPOSITORY / "cfgs" / "avp" / f"{name}.yaml"), "--no_eval", "--device", "cpu"]
    monkeypatch.setattr(sys, "argv", [*words, "--set", "DATA_CONFIG.DATA_PATH", str(tmp_path / "none")])
    tool.main()
    assert ["cp_small_scratch.yaml is made for" in text for text in said[:-1]] == [True] * slow
    assert given[3].recompute_encoders == slow


def test_half_precision_on_a_cpu_and_an_odd_batch_are_refused(call, tmp_path):
    with pytest.raises(ConfigError, match="--use_amp: a CPU computes in bf16 or in full precision"):
        call(tmp_path, "train", "--use_amp", "--device", "cpu", overrides=("OPTIMIZATION.AMP_DTYPE", "fp16"))


def test_a_wrong_input_is_one_line_and_exit_status_2(tmp_path, monkeypatch, capsys):
    tool = str(REPOSITORY / "tools" / "train.py")
    monkeypatch.setattr(sys, "argv", [tool, "--cfg", str(tmp_path / "none.yaml")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(tool, run_name="__main__")
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {tmp_path / 'none.yaml'}: there is no file of this name")


def copied_without(split, instead, tiny_data, folder):
    """A copy of a data set whose scenes of one split belong to another."""
    shutil.copytree(tiny_data, folder)
    manifest = json.loads((folder / "dataset.json").read_text())
    for scene in manifest["scenes"]:
        scene["split"] = instead if scene["split"] == split else scene["split"]
    (folder / "dataset.json").write_text(json.dumps(manifest))
    return folder


def test_without_a_validation_split_no_scores_are_chosen_and_it_says_so(call, tiny_data, tmp_path):
    data = copied_without("val", "train", tiny_data, tmp_path / "data")
    call(tmp_path, "train", "--epochs", 1, "--picture_interval", 1, data=data)
    run = tmp_path / "output" / "avp" / "cp_tiny" / "default"
    assert "no validation split: no score thresholds" in _log(run)
    assert "score_thresholds" not in read_checkpoint(run / "ckpt" / "checkpoint_epoch_1.pth")


def test_without_a_test_split_the_validation_split_is_tested_and_it_says_so(call, tiny_data, tmp_path):
    data = copied_without("test", "train", tiny_data, tmp_path / "data")
    call(tmp_path, "train", "--epochs", 1, "--picture_interval", 1, data=data)
    run = tmp_path / "output" / "avp" / "cp_tiny" / "default"
    assert "no test split: tested on its validation split" in _log(run)
    (result,) = (run / "eval" / "checkpoint_epoch_1").glob("*/result.json")
    assert json.loads(result.read_text())["meta"]["split"] == "val"


@pytest.fixture(scope="module")
def depth_cfg(tmp_path_factory):
    """cp_tiny's depth branch as a configuration file."""
    file = tmp_path_factory.mktemp("cfgs") / "cfgs" / "avp" / "cp_tiny_depth.yaml"
    file.parent.mkdir(parents=True)
    base = REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml"
    file.write_text(
        f"_BASE_CONFIG_: {base}\nMODEL: {{NAME: CameraDepth, AGENTS: [ego, infra]}}\n"
        "OPTIMIZATION: {SENSOR_SETS: [C+C], NUM_EPOCHS: 2}\n"
    )
    return file


def _depth(load_tool, folder, data, cfg, name, *words, overrides=()):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        line = [name, "--cfg", cfg, "--workers", 0, *words, "--set", "DATA_CONFIG.DATA_PATH", data, *overrides]
        patch.setattr(sys, "argv", [str(word) for word in line])
        load_tool(name).main()


def test_a_depth_branch_starts_from_a_whole_network_ends_in_a_table_and_goes_back(
    load_tool, call, tiny_data, depth_cfg, trained, tmp_path, capsys
):
    """Each agent's branch by itself from the trained network; both files then start a whole network."""
    files = []
    for agent in ("ego", "infra"):
        words = ["--extra_tag", agent, "--pretrained_model", trained / "ckpt" / LAST]
        one = ["MODEL.AGENTS", f"[{agent}]"]
        _depth(load_tool, tmp_path, tiny_data, depth_cfg, "train", "--epochs", 1, *words, overrides=one)
        run = tmp_path / "output" / "avp" / "cp_tiny_depth" / agent
        files.append(run / "ckpt" / "checkpoint_epoch_1.pth")
        result = json.loads((run / "eval" / "checkpoint_epoch_1" / "val" / "depth.json").read_text())
        assert {row["source"] for row in result["rows"]} == {f"{agent}_camera"}
        assert sum(row["pixels"] for row in result["rows"]) > 0
        assert "| camera | depth (m) |" in capsys.readouterr().out
    call(tmp_path, "train", "--epochs", 1, "--no_eval", "--pretrained_model", trained / "ckpt" / LAST, *files)
    log = _log(tmp_path / "output" / "avp" / "cp_tiny" / "default")
    assert log.count("loaded") == 3


def test_a_killed_depth_training_goes_on_and_its_table_can_be_asked_for_again(
    load_tool, tiny_data, depth_cfg, trained, tmp_path
):
    _depth(load_tool, tmp_path, tiny_data, depth_cfg, "train", "--epochs", 2)
    run = tmp_path / "output" / "avp" / "cp_tiny_depth" / "default"
    whole = read_checkpoint(run / "ckpt" / LAST)["model_state"]
    (run / "ckpt" / LAST).unlink()
    _depth(load_tool, tmp_path, tiny_data, depth_cfg, "train", "--epochs", 2, "--no_eval")
    again = read_checkpoint(run / "ckpt" / LAST)["model_state"]
    assert all(torch.equal(again[key], whole[key]) for key in whole)
    for name, path in (("own", run / "ckpt" / LAST), ("whole_network", trained / "ckpt" / LAST)):
        words = ["--ckpt", path, "--json", tmp_path / f"{name}.json"]
        _depth(load_tool, tmp_path, tiny_data, depth_cfg, "test", *words)
    own = json.loads((run / "eval" / "checkpoint_epoch_2" / "val" / "depth.json").read_text())["rows"]
    assert json.loads((tmp_path / "own.json").read_text())["rows"] == own
    assert json.loads((tmp_path / "whole_network.json").read_text())["rows"] != own


def test_a_finished_checkpoint_under_a_new_tag_gives_the_table_of_that_checkpoint(call, trained, tmp_path):
    ckpt = trained / "ckpt" / LAST
    call(tmp_path, "train", "--epochs", 2, "--extra_tag", "again", "--ckpt", ckpt)
    run = tmp_path / "output" / "avp" / "cp_tiny" / "again"
    tables = [json.loads((r / "eval" / Path(LAST).stem / "test" / "result.json").read_text()) for r in (run, trained)]
    assert tables[0]["meta"]["weights_hash"] == tables[1]["meta"]["weights_hash"]
    assert tables[0]["rows"] == tables[1]["rows"]


def test_a_finished_checkpoint_is_not_mistaken_for_another_one_of_its_name(workplace, call, tmp_path):
    """It is neither tested in the place of the one that was asked for nor written over."""
    folder, run = workplace
    other, before = read_checkpoint(run / "ckpt" / LAST), (run / "ckpt" / LAST).read_bytes()
    other["model_state"]["dense_head.conv_cls.bias"] += 1.0
    (tmp_path / "other").mkdir()
    torch.save(other, tmp_path / "other" / LAST)
    with pytest.raises(
        CheckpointError, match=rf"{LAST}: has other weights \(\w+\) than the finished run .*--extra_tag"
    ):
        call(folder, "train", "--epochs", 2, "--ckpt", tmp_path / "other" / LAST)
    assert (run / "ckpt" / LAST).read_bytes() == before


def test_going_back_to_an_earlier_checkpoint_says_what_it_leaves(workplace, call):
    folder, run = workplace
    earlier, before = run / "ckpt" / "checkpoint_epoch_1.pth", read_checkpoint(run / "ckpt" / LAST)["model_state"]
    call(folder, "train", "--epochs", 2, "--no_eval", "--ckpt", earlier)
    assert "holds a checkpoint of iteration 4, --ckpt is of iteration 2" in _log(run)
    again = read_checkpoint(run / "ckpt" / LAST)["model_state"]
    assert all(torch.equal(again[key], before[key]) for key in before)


def test_going_back_behind_later_epochs_keeps_what_is_trained(workplace, call):
    folder, run = workplace
    shutil.copy(run / "ckpt" / LAST, run / "ckpt" / "checkpoint_epoch_7.pth")
    earlier = run / "ckpt" / "checkpoint_epoch_1.pth"
    call(folder, "train", "--epochs", 2, "--no_eval", "--ckpt", earlier, "--max_ckpt_save_num", 1)
    assert {file.name for file in (run / "ckpt").glob("*epoch*")} == {LAST, "checkpoint_epoch_7.pth"}


def test_weights_from_two_places_are_refused(call, tmp_path):
    with pytest.raises(ConfigError, match="--ckpt and --pretrained_model: give one of them"):
        call(tmp_path, "train", "--ckpt", "a.pth", "--pretrained_model", "b.pth")
    assert not list(tmp_path.iterdir())


def test_a_second_training_in_the_same_folder_is_refused(workplace, call):
    """They would write over each other's checkpoints, and each would test the other's."""
    pytest.importorskip("fcntl")
    folder, run = workplace
    before = sorted(run.rglob("*"))
    with sole_user(run), pytest.raises(RecordError, match=rf"\.lock: held by process {os.getpid()} on"):
        call(folder, "train", "--epochs", 2, "--no_eval", "--seed", 1)
    assert sorted(run.rglob("*")) == before


def test_a_copy_without_times_is_not_trained_again(workplace, call, trained):
    folder, run = workplace
    for age_s, name in ((0, "checkpoint_epoch_1.pth"), (500, LAST)):
        os.utime(run / "ckpt" / name, (1e9 - age_s, 1e9 - age_s))
    call(folder, "train", "--epochs", 2, "--no_eval")
    assert "training is complete at iteration 4" in _log(run)
    assert read_checkpoint(run / "ckpt" / LAST)["it"] == 4


def test_classes_in_another_order_are_refused_and_may_be_insisted_on(call, trained, tmp_path):
    ckpt, swapped = trained / "ckpt" / LAST, ["CLASS_NAMES", "[Pedestrian, Car]"]
    how = ("train", "--epochs", 1, "--no_eval", "--pretrained_model", ckpt)
    with pytest.raises(CheckpointError, match=r"CLASS_NAMES is \['Car', 'Pedestrian'\] .*--ignore_config CLASS_NAMES$"):
        call(tmp_path, *how, overrides=swapped)
    call(tmp_path, *how, "--ignore_config", "CLASS_NAMES", overrides=swapped)
    assert "used although CLASS_NAMES is" in _log(tmp_path / "output" / "avp" / "cp_tiny" / "default")


def test_a_misspelt_folder_beside_a_data_set_is_not_filled(call, tiny_data, tmp_path):
    misspelt = tiny_data.with_name(tiny_data.name[:-1])
    with pytest.raises(ConfigError, match=rf"no data set there, but there is {tiny_data}; .*create_data\.py --out"):
        call(tmp_path, "train", data=misspelt)
    assert not misspelt.exists()


@pytest.mark.parametrize("generator", [{"IMPORT": {"FORMAT": "carla"}}, {}])
def test_an_unfinished_import_or_recording_is_not_taken_for_a_generated_set(generator, load_tool, tmp_path):
    """It was "a data set with another generator", and the advice was to remove it."""
    write_manifest(tmp_path, Manifest((Scene("a", "train", ("0",)),), complete=False, generator=generator))
    before = (tmp_path / "dataset.json").read_bytes()
    load_tool("train")._make_data(EasyDict(DATA_CONFIG={"DATA_PATH": str(tmp_path)}), None, None)
    assert (tmp_path / "dataset.json").read_bytes() == before


def test_a_tilde_in_the_data_path_is_the_home_folder(call, tiny_data, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tiny_data.parent))
    call(tmp_path, "train", "--epochs", 1, "--no_eval", data=f"~/{tiny_data.name}")
    assert not (tmp_path / "~").exists()


def test_recordings_without_cameras_train_and_are_tested_with_what_they_have(call, tiny_data, tmp_path):
    data = tmp_path / "lidar_only"
    shutil.copytree(tiny_data, data)
    for file in data.glob("scenes/*/*/frame.json"):
        frame = json.loads(file.read_text())
        frame["ego"]["camera"] = frame["roadside_units"][0]["camera"] = None
        file.write_text(json.dumps(frame))
    call(tmp_path, "train", "--epochs", 1, data=data)
    run = tmp_path / "output" / "avp" / "cp_tiny" / "default"
    result = json.loads((run / "eval" / "checkpoint_epoch_1" / "test" / "result.json").read_text())
    assert {row["combo"] for row in result["rows"]} == {"CL+none", "CL+CL"}
    assert "sensor combinations CL+none, CL+CL only" in _log(run)
    ckpt = run / "ckpt" / "checkpoint_epoch_1.pth"
    with pytest.raises(SensorError, match=r"--combos: C\+none: recorded are ego_lidar, infra_lidar only"):
        call(tmp_path, "test", "--ckpt", ckpt, "--combos", "C+none", data=data)


@pytest.mark.parametrize("flag", ["--ckpt_save_interval", "--logger_iter_interval", "--picture_interval", "--epochs"])
def test_a_zero_that_would_divide_is_refused_before_anything_starts(call, tmp_path, flag):
    with pytest.raises(ConfigError, match=rf"argument {flag}: expected 1 or more, found '0'"):
        call(tmp_path, "train", flag, 0)
    assert not list(tmp_path.iterdir())


STARTED_BY = """
import multiprocessing, sys
if __name__ == "__main__":
    multiprocessing.set_start_method(sys.argv.pop(1))
    from pcdet_avp.commands.train import run
    run()
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_training_with_workers_of_every_start_method_learns_the_same(method, call, tiny_data, tmp_path):
    """Another process trains with two workers of this start method, as macOS, Windows and Python 3.14 start them; the
    weights are, to the bit, those of a training that loads its data itself. Augmentation is on."""
    for folder in ("alone", "workers"):
        (tmp_path / folder).mkdir()
    script = tmp_path / "train_started_by.py"
    script.write_text(STARTED_BY)
    data = ("--set", "DATA_CONFIG.DATA_PATH", tiny_data, "DATA_CONFIG.DATA_AUGMENTOR.DISABLE_AUG_LIST", "[]")
    how = ("--epochs", 2, "--no_eval", "--seed", 4, "--picture_interval", 10**6)
    call(tmp_path / "alone", "train", *how, overrides=data[3:])
    command = [sys.executable, script, method, "--cfg", REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml", "--workers", 2]
    where = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": str(torch.get_num_threads())}
    done = subprocess.run(
        [str(word) for word in (*command, *how, *data)],
        cwd=tmp_path / "workers",
        env=where,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ours, expected = (
        read_checkpoint(tmp_path / folder / "output" / "avp" / "cp_tiny" / "default" / "ckpt" / LAST)
        for folder in ("workers", "alone")
    )
    assert ours["it"] == expected["it"] == 4
    assert all(torch.equal(ours["model_state"][key], value) for key, value in expected["model_state"].items())
