"""The examples as modules."""

import importlib
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def example(monkeypatch):
    """``example(name)``: the module of an example, which nothing else keeps."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield importlib.import_module
    for name in ("vehicle", "roadside_unit", "real_time"):
        sys.modules.pop(name, None)
