"""Every script of the repository at least finds what it imports."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted(
    path.relative_to(ROOT) for folder in ("benchmarks", "examples", "tools") for path in ROOT.glob(f"{folder}/*.py")
)


@pytest.mark.parametrize("script", SCRIPTS, ids=str)
def test_script_imports(script, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / script.parent)
    spec = importlib.util.spec_from_file_location(f"script_{script.stem}", ROOT / script)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    assert module.__doc__
