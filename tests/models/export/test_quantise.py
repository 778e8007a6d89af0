"""Convolutions in int8: which files change, how far their answers move, and what stays bit by bit."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.deploy.deployed import BothHalves, Deployed
from pcdet_avp.deploy.manifest import MANIFEST, Exported
from pcdet_avp.deploy.runtime import OnnxRuntime, OpenVino
from pcdet_avp.errors import ExportError
from pcdet_avp.models.export import quantise
from pcdet_avp.models.export.quantise import QUANTISED, Calibration, quantise_convolutions
from pcdet_avp.structures.sensor_set import SensorSet

FRAMES = 2


@pytest.fixture(scope="module")
def int8(to_export, exported, tmp_path_factory):
    """Folder of the exported network with its convolutions in int8, and the samples that its ranges come from."""
    folder = shutil.copytree(exported, tmp_path_factory.mktemp("int8") / "exported")
    sensors = SensorSet.parse("CL+CL")
    frames = [to_export.dataset.read(i % len(to_export.dataset), sensors) for i in range(FRAMES)]
    samples = [prepare(frame, sensors, to_export.dataset.prepare_config) for frame in frames]
    quantise_convolutions(folder, Calibration(samples, [frame.frame_id for frame in frames], "train"))
    return SimpleNamespace(folder=folder, samples=samples)


def manifest(folder):
    return json.loads((folder / MANIFEST).read_text())


def test_the_manifest_says_the_precision_of_every_file_and_the_frames(int8, exported):
    before, after = manifest(exported), manifest(int8.folder)
    assert {name: one["precision"] for name, one in after["files"].items()} == {
        name: "int8" if name in QUANTISED else "float32" for name in before["files"]
    }
    assert after["precision"] == "int8"
    assert len(after["calibration"]["frames"]) == FRAMES
    assert after["calibration"]["split"] == "train"
    for name in before["files"]:
        same = before["files"][name]["sha256"] == after["files"][name]["sha256"]
        assert same == (name not in QUANTISED)
        assert Exported.read(int8.folder).graph(name)  # the hashes are the new files'


def test_every_convolution_reads_int8_and_nothing_else_does(int8):
    import onnx

    for name in QUANTISED:
        nodes = onnx.load(int8.folder / name).graph.node
        made_by = {output: node.op_type for node in nodes for output in node.output}
        convolutions = [node for node in nodes if node.op_type == "Conv"]
        assert convolutions
        assert all(made_by[node.input[k]] == "DequantizeLinear" for node in convolutions for k in (0, 1))
        others = {
            made_by.get(x) for node in nodes if node.op_type in ("MatMul", "Gemm", "ConvTranspose") for x in node.input
        }
        assert "QuantizeLinear" not in others


def test_a_lidar_map_keeps_its_bytes_and_a_camera_map_moves_a_little(int8, exported):
    latents = [
        BothHalves(Deployed(Exported.read(folder), OnnxRuntime(1))).latents(int8.samples[0])
        for folder in (exported, int8.folder)
    ]
    (before, after) = ({source: one.copy() for source, one in of.items()} for of in latents)
    np.testing.assert_array_equal(after["infra_lidar"], before["infra_lidar"])
    off = np.abs(after["infra_camera"] - before["infra_camera"])
    assert 0 < off.max() < 0.5 * np.abs(before["infra_camera"]).max()
    assert off.mean() < 0.05 * before["infra_camera"].std()


def test_scores_stay_near(int8, exported):
    found = [
        BothHalves(Deployed(Exported.read(folder), OnnxRuntime(1))).detect_alone(int8.samples[0])["pred_scores"]
        for folder in (exported, int8.folder)
    ]
    assert len(found[0]) >= 10
    strongest = min(10, *map(len, found))
    off = np.abs(found[1][:strongest] - found[0][:strongest])  # of random weights, from ranges of two frames
    assert off.max() < 0.2
    assert off.mean() < 0.08


def test_openvino_computes_the_same_int8_graph(int8):
    pytest.importorskip("openvino", reason="needs openvino: pip install 'pcdet_avp[deploy]'")
    exported, rng = Exported.read(int8.folder), np.random.default_rng(0)
    grid, content = exported.network.grid, exported.graph("vehicle/backbone.onnx")
    inputs = {"spatial_features": rng.random((1, exported.network.channels, grid.height, grid.width), np.float32)}
    graphs = [runtime(1).load(content, "backbone") for runtime in (OnnxRuntime, OpenVino)]
    theirs, ours = (graph(inputs)["spatial_features_2d"] for graph in graphs)
    assert np.abs(ours - theirs).mean() < 0.02 * theirs.std()


def test_a_graph_that_becomes_another_function_is_refused(int8, exported, tmp_path, monkeypatch):
    folder = shutil.copytree(exported, tmp_path / "copy")
    monkeypatch.setattr(quantise, "LARGEST_MEAN_ERROR", 1e-6)
    with pytest.raises(
        ExportError, match=r"roadside/camera.onnx: int8 differs from float32 by .* of an output's spread"
    ):
        quantise_convolutions(folder, Calibration(int8.samples[:1], ["0000/000"], "train"))
