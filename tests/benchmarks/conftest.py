"""Scripts of benchmarks/ as modules."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def load_benchmark():
    """``load_benchmark(name)``: benchmarks/<name>.py as a module."""

    def load(name):
        spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(ROOT / "benchmarks"))  # scripts share helpers
            spec.loader.exec_module(module)
        return module

    return load
