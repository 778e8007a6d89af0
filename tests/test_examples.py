"""Every example runs as its first lines say."""

import re
import runpy
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]


@pytest.fixture
def output_of(monkeypatch, capsys):
    """``output_of(name, *arguments)``: what an example prints, run as a script in this process."""

    def run(name, *arguments):
        file = str(REPOSITORY / "examples" / f"{name}.py")
        monkeypatch.setattr(sys, "argv", [file, *arguments])
        runpy.run_path(file, run_name="__main__")
        return capsys.readouterr().out

    return run


def test_custom_controller_is_compared_with_the_papers_law(output_of):
    pytest.importorskip("gymnasium")
    lines = output_of("custom_controller", "--episodes", "1", "--speed", "6").splitlines()
    assert [line[:17].strip() for line in lines] == ["the paper's law", "custom controller"]
    assert "0/1 crashes" in lines[0]  # nobody is hit at 6 m/s by who knows everything


def test_custom_perception_sees_pedestrians_and_the_turning_vehicle(output_of):
    text = output_of("custom_perception", "--episodes", "1")
    assert [float(m) > 8 for m in re.findall(r"first detection ([\d.]+) m", text)] == [True, True]
    assert text.count("contact none") == 2


@pytest.mark.parametrize("wrong", [("--episodes", "0"), ("--speed", "nan"), ("--speed", "-3")])
@pytest.mark.parametrize("name", ["custom_controller", "custom_perception"])
def test_a_drive_that_cannot_be_is_one_line(name, wrong, output_of, capsys):
    pytest.importorskip("gymnasium")
    with pytest.raises(SystemExit) as ended:
        output_of(name, *wrong)
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert told.err.startswith(f"error: argument {wrong[0]}: expected ")
    assert f"found '{wrong[1]}'" in told.err
    assert (told.err.count("\n"), told.out) == (1, "")


def test_the_example_of_the_page_on_the_closed_loop_films_an_episode(monkeypatch):
    """Its code is run as it stands there; only the drawing is left out."""
    from pcdet_avp.closed_loop.video import video

    calls = []
    monkeypatch.setattr(video, "write_episode_video", lambda *arguments: calls.append(arguments))
    monkeypatch.chdir(REPOSITORY)
    page = (REPOSITORY / "docs" / "closed_loop.md").read_text()
    code = next(
        block for block in re.findall(r"```python\n(.+?)```", page, re.DOTALL) if "write_episode_video" in block
    )
    exec(code, {})
    (scenario, perceiver, sensor_set, cfg, file, _), *more = calls
    assert not more
    assert (scenario.name, scenario.cruising_mps, sensor_set.name, file.suffix) == ("t_junction", 8.0, "C+CL", ".mp4")
    assert perceiver.perceive(scenario.world(), 0, sensor_set).missed is not None  # los knows what it misses
    assert "SENSORS" in cfg
