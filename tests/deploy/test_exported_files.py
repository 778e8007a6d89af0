"""Exported files: refused where they are damaged or mean something else, written whole or not at all."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from pcdet_avp.deploy import runtime
from pcdet_avp.deploy.manifest import MANIFEST, Exported
from pcdet_avp.deploy.network import Network
from pcdet_avp.errors import ExportError, OutputError
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.models.export import write
from pcdet_avp.models.export.opened import open_deployed


@pytest.fixture
def copy(exported, tmp_path):
    """A copy of the exported network that a test may damage."""
    return shutil.copytree(exported, tmp_path / "copy")


def changed(folder, **keys):
    content = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps({**content, **keys}))


def test_the_manifest_says_what_the_weights_mean(exported, to_export):
    content = json.loads((exported / MANIFEST).read_text())
    assert content["meaning"]["CLASS_NAMES"] == ["Car", "Pedestrian"]
    assert content["meaning"] == json.loads(json.dumps(dict(to_export.network.meaning.values)))
    assert content["precision"] == "float32"
    assert content["network"]["class_names"] == ["Car", "Pedestrian"]
    assert content["network"]["cameras"]["ego"]["bins"]["count"] == 24
    files = {path.relative_to(exported).as_posix() for path in exported.rglob("*.onnx")}
    assert files == set(content["files"])
    assert {"roadside/camera.onnx", "roadside/compress_lidar.onnx", "vehicle/warp.onnx", "vehicle/head.onnx"} <= files
    assert not any(name.startswith("roadside/") and "decompress" in name for name in files)
    assert all(one["largest_error"] < 1e-3 for one in content["files"].values())


def test_what_the_graphs_leave_open_survives_json(exported):
    network = Exported.read(exported).network
    assert Network.from_json(json.loads(json.dumps(network.as_json()))) == network
    limited = replace(network, map_size=MapSize(1475, constant=True))
    content = json.loads(json.dumps(limited.as_json()))
    assert Network.from_json(content) == limited
    del content["map_size"]  # exported before there was a limit
    assert Network.from_json(content) == network


def test_graphs_are_standard_onnx_with_any_number_of_points(exported):
    import onnx

    for path in exported.rglob("*.onnx"):
        model = onnx.load(path)
        onnx.checker.check_model(model)
        assert [(one.domain, one.version) for one in model.opset_import] == [("", 20)]
        assert not model.functions
    rows = onnx.load(exported / "roadside" / "points_0.onnx").graph.input[0].type.tensor_type.shape.dim
    assert rows[0].dim_param
    assert rows[1].dim_value == 10
    columns = {
        one.name: one.type.tensor_type.shape.dim[0]
        for one in onnx.load(exported / "vehicle" / "camera.onnx").graph.input
    }
    assert columns["pixels"].dim_param == columns["weights"].dim_param != ""


def test_no_graph_chooses_among_equal_values(exported):
    """Runtimes do not agree about which ones (findings/openvino_ties.sh): of TopK only the values are read, as a
    threshold."""
    import onnx

    for path in exported.rglob("*.onnx"):
        graph = onnx.load(path).graph
        read = {name for node in graph.node for name in node.input} | {one.name for one in graph.output}
        assert not {node.op_type for node in graph.node} & {"ArgMax", "ArgMin", "NonMaxSuppression", "Unique"}
        strongest = [node for node in graph.node if node.op_type == "TopK"]
        assert len(strongest) == path.name.startswith("compress")
        assert not read & {node.output[1] for node in strongest}


def test_a_graph_that_was_changed_is_refused(copy):
    path = copy / "vehicle" / "head.onnx"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(ExportError, match=r"head.onnx: damaged or replaced: SHA-256: expected"):
        Exported.read(copy).graph("vehicle/head.onnx")
    path.unlink()
    with pytest.raises(ExportError, match=r"head.onnx: cannot be read \(No such file"):
        Exported.read(copy).graph("vehicle/head.onnx")


def test_what_is_no_exported_network_is_refused(copy, tmp_path):
    with pytest.raises(ExportError, match=r"manifest.json: cannot be read .*tools/export.py"):
        Exported.read(tmp_path)
    changed(copy, format=99)
    with pytest.raises(ExportError, match="format: expected 1, found 99; export the checkpoint again"):
        Exported.read(copy)
    changed(copy, format=1, network={"class_names": []})
    with pytest.raises(ExportError, match="damaged, or written by another version"):
        Exported.read(copy)
    for text in ("{", "[]"):
        (copy / MANIFEST).write_text(text)
        with pytest.raises(ExportError, match=r"manifest.json: damaged"):
            Exported.read(copy)


def test_a_manifest_that_was_edited_is_refused(copy):
    """Classes in another order would be read in it; one exported before there was a hash is taken as it is."""
    content = json.loads((copy / MANIFEST).read_text())
    told = r"manifest.json: network and meaning: not what was exported; export the checkpoint"
    for key, value in (("class_names", ["Pedestrian", "Car"]), ("cell_m", 0.32)):
        changed(copy, network={**content["network"], key: value})
        with pytest.raises(ExportError, match=told):
            Exported.read(copy)
    changed(copy, described_sha256=None)
    assert Exported.read(copy).network.cell_m == 0.32
    changed(copy, **content)
    assert Exported.read(copy).network.class_names == ("Car", "Pedestrian")
    changed(copy, meaning={})  # which would fit any configuration
    with pytest.raises(ExportError, match=told):
        Exported.read(copy)
    for files in ({"vehicle/head.onnx": {}}, {"vehicle/head.onnx": "abc"}, ["vehicle/head.onnx"]):
        changed(copy, **{**content, "files": files})
        with pytest.raises(ExportError, match=r"manifest.json: damaged, or written by another version"):
            Exported.read(copy)


def test_weights_of_another_configuration_are_refused_by_key(copy, to_export):
    pytest.importorskip("onnxruntime")
    meaning = json.loads((copy / MANIFEST).read_text())["meaning"]
    changed(copy, meaning={**meaning, "CLASS_NAMES": ["Pedestrian", "Car"]}, described_sha256=None)
    with pytest.raises(ExportError, match=r"CLASS_NAMES is .*--ignore_config CLASS_NAMES"):
        open_deployed(copy, "onnxruntime", to_export.cfg)


def test_an_export_that_fails_leaves_nothing(to_export, tmp_path, monkeypatch):
    def fails(piece, content):
        raise ExportError(f"{piece.file}: made to fail")

    monkeypatch.setattr(write, "graph_of", lambda piece: b"")
    monkeypatch.setattr(write, "compare", fails)
    with pytest.raises(ExportError, match=r"roadside/camera.onnx: made to fail"):
        write.export_network(to_export.network, to_export.cfg.CLASS_NAMES, (108, 192), tmp_path / "out", {})
    assert list(tmp_path.iterdir()) == []


def test_only_an_earlier_export_is_replaced(to_export, tmp_path, monkeypatch):
    monkeypatch.setattr(write, "graph_of", lambda piece: b"")
    monkeypatch.setattr(write, "compare", lambda piece, content: 0.0)
    for _ in range(2):
        files = write.export_network(to_export.network, to_export.cfg.CLASS_NAMES, (108, 192), tmp_path / "out", {})
        assert len(files) == 15
    for name in ("mine/thesis.tex", f"page/{MANIFEST}", "out/vehicle/notes.txt"):  # web pages have a manifest.json, too
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("years of work")
        folder = tmp_path / file.relative_to(tmp_path).parts[0]
        with pytest.raises(OutputError, match=f"holds .*{file.name}, which is no part of an exported network"):
            write.export_network(to_export.network, to_export.cfg.CLASS_NAMES, (108, 192), folder, {})
        assert file.read_text() == "years of work"


def test_the_working_folder_may_be_exported_to(to_export, tmp_path, monkeypatch):
    monkeypatch.setattr(write, "graph_of", lambda piece: b"")
    monkeypatch.setattr(write, "compare", lambda piece, content: 0.0)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    write.export_network(to_export.network, to_export.cfg.CLASS_NAMES, (108, 192), Path(), {})
    assert {file.name for file in (tmp_path / "out").iterdir()} == {MANIFEST, "roadside", "vehicle"}
    assert [file.name for file in tmp_path.iterdir()] == ["out"]


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setattr(write, "LIBRARIES", ("onnx_of_the_future",))
    with pytest.raises(ExportError, match=r"exporting needs onnx_of_the_future: pip install 'pcdet_avp\[export\]'"):
        write._check_libraries()
    with pytest.raises(ExportError, match=r"runtime 'tensorrt': expected one of onnxruntime, openvino"):
        runtime.open_runtime("tensorrt")
    monkeypatch.setitem(__import__("sys").modules, "openvino", None)
    with pytest.raises(ExportError, match="--runtime openvino: not installed"):
        runtime.open_runtime("openvino")


def test_what_is_no_graph_is_refused():
    for name in runtime.RUNTIMES:
        pytest.importorskip(name)
        with pytest.raises(ExportError, match=r"some.onnx: \w+ cannot load it"):
            runtime.open_runtime(name, 1).load(b"no graph", "some.onnx")


def test_openvino_computes_in_float32_whatever_it_would_choose(exported):
    openvino = pytest.importorskip("openvino", reason="needs openvino: pip install 'pcdet_avp[deploy]'")
    chosen = runtime.OpenVino(1)
    chosen._core.set_property("CPU", {runtime.PRECISION_HINT: "bf16"})  # what it prefers on CPUs that have bf16
    content = Exported.read(exported).graph("roadside/points_0.onnx")
    assert chosen.load(content, "points")  # raises where the compiled graph is not in float32
    del chosen._options[runtime.PRECISION_HINT]
    if "BF16" not in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
        pytest.skip("this CPU has no bf16 to choose")
    with pytest.raises(ExportError, match="INFERENCE_PRECISION_HINT: expected f32, found bf16"):
        chosen.load(content, "points")
