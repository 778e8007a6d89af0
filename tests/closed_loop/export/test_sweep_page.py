"""Which trial of a sweep is shown, and that the report leads to its page."""

from pcdet_avp.closed_loop.export.sweep_page import episode_stem, telling_trial
from pcdet_avp.closed_loop.report.report import _episode_pages
from pcdet_avp.closed_loop.sweep.episode_row import COLUMNS, Case, EpisodeRow


def row(combo, speed, trial, crashed):
    values = dict.fromkeys(COLUMNS) | {"crashed": crashed, "outcome": "front" if crashed else "none"}
    names = {"scenario": "t_junction", "perception": "los", "combo": combo, "speed": speed, "trial": trial}
    return EpisodeRow.from_columns(values | names)


def test_the_slowest_trial_in_which_only_the_vehicle_alone_crashed_is_shown():
    rows = [row("C+none", 8.0, 0, True), row("C+CL", 8.0, 0, False)]
    rows += [row("C+none", 7.0, 1, True), row("C+CL", 7.0, 1, False), row("C+CL", 6.0, 0, True)]
    assert telling_trial(rows)[2:] == ("C+CL", 7.0, 1)


def test_without_such_a_trial_the_fastest_pair_is_shown():
    rows = [row("C+none", 7.0, 0, False), row("C+CL", 7.0, 0, False), row("CL+CL", 9.0, 0, False)]
    assert telling_trial(rows)[2:] == ("C+CL", 7.0, 0)
    assert telling_trial(rows[2:])[2:] == ("CL+CL", 9.0, 0)
    assert telling_trial([]) is None


def test_the_report_leads_to_the_pages_of_its_section(tmp_path):
    stem = episode_stem(Case("t_junction@plans/a.yaml", "los", "C+CL", 7.0, 1))
    (tmp_path / "episodes").mkdir()
    (tmp_path / "episodes" / f"{stem}.html").touch()
    lines = _episode_pages(tmp_path, "t_junction@plans/a.yaml", "los")
    assert f"- [{stem}](episodes/t_junction_a_los_C%2BCL_7_1.html)" in lines
    assert _episode_pages(tmp_path, "t_junction", "los") == []


def test_episodes_at_nearly_the_same_speed_have_files_of_their_own():
    stems = {episode_stem(Case("t_junction", "los", "C+CL", speed, 1)) for speed in (6.0, 6, 6.0000001)}
    assert stems == {"t_junction_los_C+CL_6_1", "t_junction_los_C+CL_6.0000001_1"}
