"""``tools/safety_eval.py --perception model`` as a user meets it: an episode from end to end, and what is refused."""

import csv
import hashlib
import json
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from pool_here import PoolHere

from pcdet_avp.closed_loop.perception.network import untrained
from pcdet_avp.closed_loop.sweep import sweep as sweep_module
from pcdet_avp.config import load_config
from pcdet_avp.engine.checkpoint import save
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY

CFGS = Path(__file__).parents[2] / "cfgs" / "avp"


@pytest.fixture(scope="module")
def ckpt(tmp_path_factory):
    """A network that has learnt nothing and is sure of nothing: the ego drives on."""
    path = tmp_path_factory.mktemp("weights") / "tiny.pth"
    state = untrained(load_config(CFGS / "cp_tiny.yaml")).network.state_dict()
    save(path, {"model_state": state, THRESHOLDS_KEY: {"Car": 0.9, "Pedestrian": 0.9}})
    return path


@pytest.fixture
def drive(load_tool, tmp_path, monkeypatch):
    """``drive(*arguments)``: the tool's main; the folder of its results."""

    def run(*arguments, how=("--trials", 1)):
        words = ["safety_eval", "--cfg", CFGS / "cp_tiny.yaml", "--scenario", "t_junction", "--combos", "C+C"]
        words += ["--speeds", 9, *how, "--workers", 1, "--out", tmp_path, "--perception", *arguments]
        monkeypatch.setattr(sys, "argv", [str(word) for word in words])
        load_tool("safety_eval").main()
        return tmp_path

    return run


def test_an_episode_over_a_lossy_link_that_is_cut(drive, ckpt):
    folder = drive("model", "--ckpt", ckpt, "--link", "nr_v2x", "--block_loss", 0.3, "--cut_within_s", 2)
    with (folder / "episodes.csv").open() as file:
        (row,) = [row for row in csv.DictReader(file) if row["perception"] == "model"]
    assert row["outcome"] != "none"  # nothing was detected, so nobody braked
    assert float(row["mean_speed_mps"]) == pytest.approx(9.0)
    assert 5 < int(row["messages"]) < 47  # some tick of the first 2 s was the last, and maps are held for 300 ms
    assert 500 < float(row["message_bytes"]) < 10_000
    assert 0.05 <= float(row["message_age_s"]) < 0.2  # a tick at least


@pytest.mark.slow
def test_a_certificate_with_a_dead_camera_names_the_weights(drive, ckpt):
    """The network is sure of nothing, so the first run of the only speed crashes and ends the sequence."""
    folder = drive("model", "--ckpt", ckpt, "--fault", "dead_ego_camera", how=("--certify", "--max_minutes", 30))
    (entry,) = json.loads((folder / "certificate.json").read_text())
    assert (entry["perception"], entry["combo"], entry["speed"]) == ("model@dead_ego_camera", "C+C", None)
    assert (entry["runs"], entry["crashes"], entry["complete"]) == (1, 1, True)
    assert entry["weights"] == hashlib.sha256(ckpt.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("model",), ConfigError, "no checkpoint there; name one with --ckpt"),
        (("model", "--ckpt", "nowhere.pth"), CheckpointError, "nowhere.pth"),
        (("model", "--ckpt", "CKPT", "--delay_ms", 50), ConfigError, "--delay_ms: an ideal link has no such thing"),
        (("los", "--link", "nr_v2x"), ConfigError, "belong to --perception model"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_starts(drive, ckpt, arguments, error, message):
    with pytest.raises(error, match=message):
        drive(*(ckpt if word == "CKPT" else word for word in arguments))


def test_weights_of_another_configuration_are_refused(drive, ckpt, monkeypatch):
    """Where an episode begins; that an error comes out of a worker, tests/test_parallel.py says."""

    def of_the_network(waiting):
        return next(job for job in waiting if job.case.perception == "model")

    monkeypatch.setattr(sweep_module, "task_pool", lambda function, *_: nullcontext(PoolHere(function, of_the_network)))
    with pytest.raises(CheckpointError, match=r"tiny.pth: made with another configuration"):
        drive("model", "--ckpt", ckpt, "--set", "MODEL.BACKBONE_2D.NUM_FILTERS", "[16, 24]")
