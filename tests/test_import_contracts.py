"""Who may import whom (the house's floors), checked in fresh interpreters."""

import functools
import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from import_graph import circle, module_graph, room_graph

import pcdet_avp

PACKAGE = Path(pcdet_avp.__file__).parent


def modules_of(floor):
    """Every module below ``pcdet_avp.<floor>``, by name; of no floor, the package alone."""
    if not floor:
        return ["pcdet_avp"]
    root = PACKAGE / floor
    if root.with_suffix(".py").exists():
        return [f"pcdet_avp.{floor.replace('/', '.')}"]
    found = pkgutil.walk_packages([str(root)], prefix=f"pcdet_avp.{floor}.")
    return [f"pcdet_avp.{floor}", *(module.name for module in found)]


@functools.cache
def loaded_after(*floors):
    """Names in sys.modules of a fresh interpreter that imports every module of some floors."""
    modules = [name for floor in floors for name in modules_of(floor)]
    imports = f"[importlib.import_module(m) for m in {modules!r}]"
    code = f"import importlib, json, sys; {imports}; print(json.dumps([*sys.modules]))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return set(json.loads(result.stdout.splitlines()[-1]))


def test_importing_the_package_costs_nothing():
    loaded = loaded_after("")
    for heavy in ("numpy", "torch", "numba", "cv2", "embreex", "yaml", "distributed"):
        assert heavy not in loaded, f"import pcdet_avp pulls in {heavy}"


# One interpreter for the floors of a rule: what none of them loads together, none loads alone.
NUMPY_FLOORS = ("structures", "sim", "link", "evaluation", "visualization", "registration", "deploy")
LOWER_FLOORS = ("structures", "link", "evaluation", "registration")
NETWORK_FLOORS = ("models", "datasets", "engine", "openpcdet", "bandwidth", "plugin")


def test_numpy_floors_never_import_torch():
    assert "torch" not in loaded_after(*NUMPY_FLOORS), f"pcdet_avp.{', '.join(NUMPY_FLOORS)} must do without torch"


OPENING_FLOORS = (
    "models.export.opened",
    "datasets.avp.frames",
    "engine.halves",
    "engine.real_time",
    "runtime_arguments",
)
RECORD_FLOORS = tuple(f"datasets.avp.{module}" for module in ("record", "manifest", "splits", "prepare", "augment"))
TABLES = ("registry", "config")


def test_exported_networks_records_samples_and_tables_need_no_torch():
    modules = (*OPENING_FLOORS, *RECORD_FLOORS, *TABLES)
    assert "torch" not in loaded_after(*(module.replace(".", "/") for module in modules))


def test_an_exported_network_needs_the_floors_below_alone():
    ours = {name for name in loaded_after("deploy") if name.startswith("pcdet_avp.")}
    floors = ("deploy", "link", "registration", "structures", "errors", "config_fields")
    allowed = tuple(f"pcdet_avp.{floor}" for floor in floors)
    assert not [name for name in ours if not name.startswith(allowed)]
    assert not {"onnxruntime", "openvino", "onnx"} & loaded_after("deploy")  # until one of them is asked for


def test_network_and_data_set_never_see_the_simulator():
    reached = sorted(name for name in loaded_after(*NETWORK_FLOORS) if name.startswith("pcdet_avp.sim"))
    assert not reached, f"pcdet_avp.{', '.join(NETWORK_FLOORS)} must not import the simulator, but load {reached}"


def test_lower_floors_do_not_look_up():
    loaded = loaded_after(*LOWER_FLOORS)
    above = tuple(
        f"pcdet_avp.{name}"
        for name in (
            "sim",
            "datasets",
            "models",
            "engine",
            "closed_loop",
            "generate",
            "openpcdet",
            "bandwidth",
            "placement",
            "commands",
            "deploy",
        )
    )
    reached = sorted(name for name in loaded if name.startswith(above))
    assert not reached, f"pcdet_avp.{', '.join(LOWER_FLOORS)} must not import {reached}"


@pytest.mark.parametrize("floors", [NETWORK_FLOORS, NUMPY_FLOORS], ids=["network", "numpy"])
def test_no_optional_framework_is_needed(floors):
    loaded = loaded_after(*floors)
    for framework in ("pcdet", "spconv", "mmengine", "mmdet3d", "carla"):
        assert framework not in loaded


# From the ground up: a room may import those before it. What is not named here is bound by no order.
PIPELINES = {
    "pcdet_avp.sim": ["garage", "layouts", "plans", "meshes", "rays", "render", "actors", "world", "scenarios", "rig"],
    "pcdet_avp.placement": [
        *("sensors", "settings", "spots", "candidates", "visibility", "choice", "front"),
        *("line_of_sight", "safe_speed", "study", "drawing", "figures", "pictures", "report"),
    ],
    "pcdet_avp.closed_loop": [
        "policy",
        "perception",
        "driver",
        "encounters",
        "episode",
        "sweep",
        "report",
        "video",
        "export",
    ],
    "pcdet_avp.models": ["backbones_image", "backbones_2d", "encoders", "detectors"],
    "pcdet_avp.engine": ["distributed", "testing", "training"],
}


def test_no_module_imports_itself_through_others():
    assert circle(module_graph()) is None


@pytest.mark.parametrize("package", ["pcdet_avp", *PIPELINES])
def test_no_room_imports_itself_through_others(package):
    assert circle(room_graph(package)) is None


@pytest.mark.parametrize("package", PIPELINES)
def test_rooms_read_as_their_pipeline(package):
    graph, order = room_graph(package), PIPELINES[package]
    assert set(order) <= set(graph)
    for place, room in enumerate(order):
        above = graph[room] & set(order[place:])
        assert not above, f"{package}.{room} imports {sorted(above)}, which come later in {' -> '.join(order)}"


def test_a_circle_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) is not None
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) is None
