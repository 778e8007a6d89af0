"""benchmarks/ap_hours.py: minutes add up over stages, and the numbers are the results' own."""

import json
import sys

import pytest


@pytest.fixture
def ap_hours(load_benchmark):
    return load_benchmark("ap_hours")


def row(combo, region, car, pedestrian):
    """One of a result, with other numbers wherever the script must not look."""
    others = {"easy": {"0.7": 1.0, "0.3": 1.0, "0.01": 2.0}, "hard": {"0.7": 3.0, "0.3": 3.0, "0.01": 4.0}}
    found = {"Car": {"0.7": car, "0.01": 5.0}, "Pedestrian": {"0.3": pedestrian, "0.01": 6.0}}
    return {"combo": combo, "region": region} | {name: {**others, "overall": ap} for name, ap in found.items()}


@pytest.fixture
def result(tmp_path):
    """``result(name, minutes, iterations, car, pedestrian)``: a file of tools/test.py with two combinations."""

    def write(name, minutes, iterations, car, pedestrian):
        rows = [row("CL+none", "camera_fov", car, pedestrian), row("CL+CL", "camera_fov", car + 10, pedestrian + 20)]
        rows += [row("CL+none", "full_range", 7.0, 8.0), row("CL+CL", "full_range", 9.0, 9.0)]
        meta = {"trained_minutes": minutes, "iterations": iterations}
        (tmp_path / name).write_text(json.dumps({"meta": meta, "rows": rows}))
        return tmp_path / name

    return write


def test_a_point_is_the_strict_overall_ap_in_the_cameras_view(ap_hours, result):
    assert ap_hours.read_point(result("1.json", 30.5, 100, 41.0, 22.0), 24.5) == {
        "minutes": 55.0,
        "iterations": 100,
        "ap": {"Car": {"CL+none": 41.0, "CL+CL": 51.0}, "Pedestrian": {"CL+none": 22.0, "CL+CL": 42.0}},
    }


def test_the_table_and_the_curve_go_on_where_the_stage_before_ended(ap_hours, result, tmp_path, monkeypatch, capsys):
    files = [result("1.json", 12.0, 100, 10.0, 5.0), result("2.json", 24.4, 200, 20.0, 7.0)]
    later, drawn = result("3.json", 35.6, 50, 30.0, 9.0), []
    monkeypatch.setattr(ap_hours, "plot", lambda *asked: drawn.append(asked))
    words = ["--stage", 0, *files, "--stage", 24.4, later, "--out", tmp_path / "a.png"]
    monkeypatch.setattr(sys, "argv", ["ap_hours.py", *map(str, words)])
    ap_hours.main()
    lines = [line.strip("|").split("|") for line in capsys.readouterr().out.splitlines()]
    cells = [[cell.strip() for cell in line] for line in lines]
    assert cells[0] == ["iterations of its stage", "minutes in all", "CL+none", "CL+CL"]
    assert cells[2:] == [
        ["100", "12", "10.0, 5.0", "20.0, 25.0"],
        ["200", "24", "20.0, 7.0", "30.0, 27.0"],
        ["50", "60", "30.0, 9.0", "40.0, 29.0"],
    ]
    ((points, starts_min, file),) = drawn
    assert [round(point["minutes"], 9) for point in points] == [12.0, 24.4, 60.0]
    assert (starts_min, file) == ([0.0, 24.4], tmp_path / "a.png")


def test_the_picture_has_a_curve_a_combination_over_hours_and_a_line_where_a_stage_begins(
    ap_hours, tmp_path, monkeypatch
):
    shown = []
    monkeypatch.setattr(ap_hours.plt.Figure, "savefig", lambda figure, file, **_: shown.append((figure, file)))
    ap = {"CL+none": 10.0, "CL+CL": 40.0}
    later = {name: value + 5 for name, value in ap.items()}
    points = [
        {"minutes": 30.0, "iterations": 1, "ap": {"Car": ap, "Pedestrian": later}},
        {"minutes": 90.0, "iterations": 2, "ap": {"Car": later, "Pedestrian": ap}},
    ]
    ap_hours.plot(points, [0.0, 45.0], tmp_path / "a.png")
    ((figure, file),) = shown
    assert file == tmp_path / "a.png"
    for panel, values in zip(figure.axes, ([[10.0, 15.0], [40.0, 45.0]], [[15.0, 10.0], [45.0, 40.0]]), strict=True):
        *curves, stage = panel.lines
        assert [list(curve.get_xdata()) for curve in curves] == [[0.5, 1.5]] * 2
        assert [list(curve.get_ydata()) for curve in curves] == values
        assert set(stage.get_xdata()) == {0.75}
    ap_hours.plt.close(figure)
