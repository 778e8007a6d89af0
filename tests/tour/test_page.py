"""The page of a tour with made-up results: its numbers are the results', and it is one file that needs no other."""

import re
from itertools import pairwise

import pytest
from tour.made_up_results import AP, STEPS
from visualization.page.html_facts import HtmlFacts

from pcdet_avp.errors import ConfigError
from pcdet_avp.tour import tables
from pcdet_avp.tour.page import tour_page
from pcdet_avp.tour.summary import comparisons, summary


@pytest.fixture(scope="session")
def facts(finished_tour):
    return HtmlFacts(finished_tour[1])


def bold(text):
    return re.findall(r"\*\*(.+?)\*\*", text)


def test_the_summary_says_the_results_numbers(made_up):
    tour, _ = made_up
    said = bold(summary(tour.findings(STEPS)))
    changes = [(AP[f"{vehicle}+none"][k], AP[f"{vehicle}+CL"][k]) for vehicle in ("C", "CL") for k in (0, 1)]
    assert said[:8] == [f"{value:.1f}" for change in changes for value in change]
    assert said[8:10] == ["5.7 kB", "6.0 kB"]  # medians of 5651 and 6049 bytes
    assert said[10:12] == ["7 m/s", "10 m/s"]  # 4 of 20 crashed at 8 m/s without the roadside, none with it
    assert said[12:] == ["1 of 3", "0 of 3", "6.5 m", "14.0 m"]


def test_the_summary_tells_limits_from_what_was_run(made_up):
    text = summary(made_up[0].findings(STEPS))
    assert "up to **10 m/s**, the fastest that was run," in text
    assert "up to **7 m/s** by itself" in text
    assert "too few episodes for a rate" in text


def test_the_comparisons_are_of_the_vehicle_with_all_sensors(made_up):
    found = comparisons(made_up[0].findings(STEPS))
    pairs = [(each.without, each.with_roadside) for each in found]
    assert pairs == [("71.0", "82.5"), ("61.5", "91.0"), ("7 m/s", "≥ 10 m/s"), ("6.5 m", "14.0 m")]
    assert "gain +11.5 [+8.1, +13.8]" in found[0].remark


def test_nothing_is_said_of_steps_that_are_still_to_come(made_up):
    tour, _ = made_up
    page = tour_page(tour, ("see", "detect"))
    assert bold(page.summary)[0] == "21.5"
    assert "m/s" not in page.summary
    assert (len(page.lead), len(page.comparisons)) == (0, 2)
    assert [section.title for section in page.sections][-1] == "How to go on"
    assert tour_page(tour, ("see",)).summary == "Nothing has been measured yet."


def test_a_result_that_is_missing_is_named(made_up, tmp_path):
    tour, _ = made_up
    gone = type(tour)(type(tour.place)(tmp_path, tour.place.weights), 3, 3)
    with pytest.raises(ConfigError, match=r"benchmark\.json: cannot be read"):
        tour_page(gone, ("detect",))


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.lines[2:]]


def test_the_benchmark_stands_beside_the_papers_with_intervals(made_up):
    table = tables.benchmark_table(made_up[0].place.benchmark(), data_seed=7)
    last = cells(table)[-1]
    assert last == ["camera, LiDAR", "camera, LiDAR", "82.5", "+11.5 [+8.1, +13.8]", "98.8", "91.0", "-", "98.9"] + [
        "5,600 + 6,100"
    ]
    assert "configuration cp_small, data seed 7, seed 3, commit 0123456789ab; `python t.py`" in table.source


def test_crashes_come_with_counts_and_intervals_beside_the_papers(made_up):
    table = tables.drive_table(made_up[0].place.sweep("model"), "t_junction", "model", 8.0)
    alone, together = cells(table)
    # 1/3: 0.8 % and 90.6 %; 0/3: 1 - 0.025^(1/3) = 70.8 % (exact interval). The paper ran 8 m/s with all sensors only.
    assert alone == ["camera, LiDAR", "none", "1/3 [1, 91]", "-", "6.5 m", "2.5 m/s", "-"]
    assert together[2:] == ["0/3 [0, 71]", "4/20 [6, 44]", "14.0 m", "2.5 m/s", "5.5 kB, 50 ms"]


def test_lost_blocks_and_what_they_cost(made_up):
    (table,) = tables.loss_tables(made_up[0].place.bandwidth(), data_seed=7)
    assert [row[:3] for row in cells(table)] == [
        ["no roadside", "71.0", "-"],
        ["none", "82.5", "-"],
        ["20 %", "80.0", "-2.5 [-4.0, +0.5]"],
    ]


def test_the_sensors_are_spelled_out_in_the_crash_table(made_up):
    table = tables.speed_table(made_up[0].place.sweep("los"), "t_junction", "los")
    assert {row[0] for row in cells(table)} == {"camera", "camera, LiDAR"}
    assert any(cell.startswith("**0/20** [0, 17]") for row in cells(table) for cell in row)


def test_no_request_leaves_the_page(facts):
    for tag, attrs, _ in facts.elements:
        for name in ("src", "href", "srcset", "poster", "action", "data"):
            value = attrs.get(name, "data:")
            assert value.startswith(("data:", "#")), f"{tag} {name}={value[:60]}"
    styles = " ".join(facts.words("style"))
    assert "@import" not in styles
    assert "url(" not in styles
    assert not facts.all("script", "iframe", "object", "embed", "base")
    policy = next(meta["content"] for meta in facts.all("meta") if "http-equiv" in meta)
    assert policy.startswith("default-src 'none'")


def test_drives_are_called_by_their_scenarios_title_and_nothing_by_its_python_object(finished_tour, facts):
    captions = [text for _, text in facts.text if text.startswith("T-junction, ")]
    assert any(text.startswith("T-junction, 8 m/s, episode ") for text in captions)
    assert any(text.startswith("T-junction, everything in line of sight is known") for text in captions)
    assert not re.search(r"\w\(\w+=| at 0x[0-9a-f]+", " ".join(text for where, text in facts.text if where != "style"))


def test_those_who_do_not_see_the_page_are_told_the_same(facts):
    assert all(image["alt"].strip() for image in facts.all("img"))
    assert len(facts.all("img")) >= 10
    assert all(video["aria-label"].strip() for video in facts.all("video"))
    assert facts.all("html")[0]["lang"] == "en"
    levels = [int(tag[1]) for tag, _, _ in facts.elements if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    tables_shown, captions = facts.all("table"), facts.words("caption")
    assert len(facts.all("caption")) == len(tables_shown) >= 8
    assert captions == []  # their text stands in paragraphs of its own


def test_every_link_of_the_page_finds_its_section(facts):
    ids = [attrs["id"] for _, attrs, _ in facts.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    links = [attrs["href"] for attrs in facts.all("a")]
    assert len(links) == len(STEPS) + 1
    assert {link.removeprefix("#") for link in links} <= set(ids)
