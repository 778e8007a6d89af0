"""tools/export.py from the command line to the benchmark, and to an episode, without torch."""

import csv
import json
import shutil
import sys

import pytest

from pcdet_avp.commands import export, safety_eval
from pcdet_avp.commands import test as test_command
from pcdet_avp.engine import checkpoint
from pcdet_avp.errors import ConfigError, ExportError
from pcdet_avp.models.export import write


@pytest.fixture
def call(to_export, tmp_path, monkeypatch):
    """``call(command, *arguments)`` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(command, *arguments):
        monkeypatch.setattr(sys, "argv", ["tool", "--cfg", str(to_export.cfg_file), *map(str, arguments)])
        return command.main()

    return run


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--runtime", "onnxruntime"), "--runtime onnxruntime needs --exported DIR"),
        (("--exported", "x"), "--exported belongs to --runtime onnxruntime or openvino, found torch"),
        (("--runtime", "openvino", "--exported", "x", "--ckpt", "y"), "--ckpt belongs to --runtime torch"),
    ],
)
def test_arguments_that_do_not_belong_together(call, arguments, words):
    with pytest.raises(ConfigError, match=words):
        call(test_command, *arguments)
    with pytest.raises(ConfigError, match=words):
        call(safety_eval, *arguments, "--scenario", "t_junction", "--perception", "model")


def test_frames_for_int8_belong_to_int8(monkeypatch):
    monkeypatch.setattr(
        sys, "argv", ["export.py", "--cfg", "cfgs/avp/cp_tiny.yaml", "--out", "x", "--calibration", "9"]
    )
    with pytest.raises(ConfigError, match="--calibration: frames for the ranges of --precision int8, found float32"):
        export.main()


def test_a_runtime_belongs_to_the_network(call):
    with pytest.raises(ConfigError, match=r"--runtime, .* belong to --perception model, found blind"):
        call(
            safety_eval, "--runtime", "openvino", "--exported", "x", "--scenario", "t_junction", "--perception", "blind"
        )
    given = ("--runtime", "onnxruntime", "--exported", "x", "--precision", "bf16")
    with pytest.raises(ConfigError, match="--precision bf16 belongs to --runtime torch; onnxruntime computes"):
        call(safety_eval, *given, "--scenario", "t_junction", "--perception", "model")


def test_a_folder_that_is_no_export_is_named(call, to_export):
    pytest.importorskip("onnxruntime")
    data = ("--set", "DATA_CONFIG.DATA_PATH", to_export.dataset.root_path)
    with pytest.raises(ExportError, match=r"nowhere/manifest.json: cannot be read"):
        call(test_command, "--runtime", "onnxruntime", "--exported", "nowhere", "--workers", 0, *data)


def test_the_manifest_names_checkpoint_and_precision(call, to_export, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(write, "graph_of", lambda piece: b"graph")
    monkeypatch.setattr(write, "compare", lambda piece, content: 0.0)
    pytest.importorskip("onnx")
    call(export, "--ckpt", to_export.path, "--out", "out")
    content = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (content["checkpoint"], content["precision"], content["opset"]) == ("random.pth", "float32", 20)
    assert content["score_thresholds"] == {"Car": 0.1, "Pedestrian": 0.1}
    assert content["weights_hash"] == checkpoint.weights_hash(to_export.network.state_dict())
    assert "15 files" in capsys.readouterr().out


def test_the_benchmark_without_torch_is_near_torchs(call, to_export, exported, tmp_path):
    data = ("--set", "DATA_CONFIG.DATA_PATH", to_export.dataset.root_path)
    how = ("--combos", "C+CL", "--wire", "--workers", "0")
    call(test_command, "--ckpt", to_export.path, *how, "--json", "torch.json", *data)
    call(test_command, "--runtime", "onnxruntime", "--exported", exported, *how, "--json", "onnx.json", *data)
    torchs, ours = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("torch", "onnx"))
    assert torchs["meta"]["runtime"] == "torch"
    assert ours["meta"]["runtime"].startswith("onnxruntime 1.")
    assert ours["meta"]["frames"] == torchs["meta"]["frames"]
    for mine, theirs in zip(ours["rows"], torchs["rows"], strict=True):
        assert mine["bytes_per_map"] == pytest.approx(theirs["bytes_per_map"], rel=0.02)
        for name in ("Car", "Pedestrian"):
            for overlap, ap in theirs[name]["overall"].items():
                assert mine[name]["overall"][overlap] == pytest.approx(ap, abs=0.5)
    assert [*tmp_path.glob("output/*/smallest/default/eval/tiny/test/onnxruntime_wire/result.json")]


DRIVING = {"Car": 0.999, "Pedestrian": 0.999}  # the network is random: the vehicle drives on, as a blind one does


@pytest.fixture
def drive(call, to_export, tmp_path):
    """``drive(out, *weights)``: the only row of an episode that the network watches."""
    cautious = checkpoint.read_checkpoint(to_export.path) | {"score_thresholds": DRIVING}
    checkpoint.save(tmp_path / "driving.pth", cautious)

    def run(out, *weights):
        how = ("--scenario", "t_junction", "--combos", "C+CL", "--speeds", 9, "--trials", 1, "--workers", 1)
        call(safety_eval, *how, "--perception", "model", "--out", tmp_path / out, *weights)
        with (tmp_path / out / "episodes.csv").open() as file:
            (row,) = [row for row in csv.DictReader(file) if row["perception"] == "model"]
        return row

    return run


@pytest.mark.slow
@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_an_episode_without_torch_is_torchs(drive, exported, tmp_path, runtime):
    pytest.importorskip(runtime)
    folder = shutil.copytree(exported, tmp_path / "driving")
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"score_thresholds": DRIVING}))
    ours = drive("ours", "--runtime", runtime, "--exported", folder)
    theirs = drive("theirs", "--ckpt", tmp_path / "driving.pth")
    sizes = [float(row.pop("message_bytes")) for row in (ours, theirs)]
    units = [row.pop("units").split("/") for row in (ours, theirs)]  # the second is bytes again
    assert ours == theirs
    assert units[0][:1] + units[0][2:] == units[1][:1] + units[1][2:]
    assert int(ours["messages"]) > 20
    assert sizes[0] == pytest.approx(sizes[1], rel=0.02)
