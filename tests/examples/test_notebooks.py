"""Every code cell of the notebooks runs in order, and they are kept without outputs."""

import json
from pathlib import Path

import matplotlib
import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def code_cells(file):
    return [cell for cell in json.loads(file.read_text())["cells"] if cell["cell_type"] == "code"]


def run(file):
    """The names that a notebook's cells leave behind."""
    names = {"__name__": "__main__"}
    for cell in code_cells(file):
        exec(compile("".join(cell["source"]), f"{file.name}:{cell['id']}", "exec"), names)
    return names


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.name)
def test_kept_without_outputs(file):
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code_cells(file))


def test_the_quickstart_notebook_draws_more_with_the_roadside(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    names = run(FOLDER / "quickstart.ipynb")
    truth = int(names["grid"].contains_bev(names["frame"].labels.boxes).sum())
    assert len(names["found"]["CL+none"].boxes) < len(names["found"]["CL+CL"].boxes) == truth
    assert "CL+CL: 4 cars, 6 pedestrians" in capsys.readouterr().out
    half = names["picture"].shape[1] // 2
    assert (names["picture"][-200:, :half] != names["picture"][-200:, half:]).any()
    names["plt"].close("all")
