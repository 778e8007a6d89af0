"""The page to scrub: its data are the episode's, it needs no other file, and its keys work in Chromium."""

import json
import re

import numpy as np
import pytest
from chromium import running_chromium

from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.export.page import _as_script, episode_page
from pcdet_avp.closed_loop.export.page_data import page_data


def data_of(page):
    return json.loads(re.search(r'<script type="application/json" id="episode">(.*?)</script>', page, re.DOTALL)[1])


def test_the_page_holds_both_drives_tick_by_tick(junction):
    roadside, alone = (driven.record for driven in junction)
    data = data_of(episode_page([alone, roadside]))
    assert [drive["name"] for drive in data["drives"]] == ["C+none", "C+CL"]
    assert data["title"] == "t_junction, C+none and C+CL"
    for drive, record in zip(data["drives"], (alone, roadside), strict=True):
        np.testing.assert_allclose(drive["ego"], record.ego, atol=6e-4)
        np.testing.assert_allclose(drive["speed"], record.log.speeds, atol=6e-4)
        np.testing.assert_allclose(drive["target"], record.log.targets, atol=6e-4)
        assert len(drive["found"]) == len(record.found)
    assert data["drives"][0]["alone"] is None
    assert set(data["drives"][1]["bytes"]) == {0, 1000}
    assert len(data["plan"]["parked"]) == sum(user.stands for user in roadside.users)
    assert data["plan"]["units"][0][:3] == [0, 0.0, 0.0]


def test_the_page_needs_no_other_file(junction):
    page = episode_page([junction[0].record])
    assert not re.findall(r'(?:src|href)="(?!data:)|url\(|https?:', page)


def test_a_title_cannot_end_the_data(junction):
    data = page_data([junction[0].record])
    data["title"] = "</script>"
    assert "</script>" not in _as_script(data)
    assert json.loads(_as_script(data))["title"] == "</script>"


@pytest.fixture(scope="module")
def opened(junction, tmp_path_factory):
    (file,) = FORMATS["html"].write(junction, tmp_path_factory.mktemp("page") / "e", ExportSettings())
    with running_chromium() as browser:
        page, said = browser.new_page(viewport={"width": 390, "height": 844}), []
        page.set_default_timeout(120_000)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda asked: said.append(asked.url) if asked.url.startswith("http") else None)
        page.goto(file.as_uri())
        yield page, said


def at(page):
    return int(page.input_value("#tick"))


@pytest.mark.slow
def test_the_keys_move_the_time_and_play(opened, junction):
    page, said = opened
    record, start = junction[0].record, at(page)
    assert start == min(driven.record.first_shown() for driven in junction)
    for key, moved in (("ArrowRight", 1), ("ArrowLeft", 0), ("Shift+ArrowRight", 10)):
        page.keyboard.press(key)
        assert at(page) == start + moved
    shown = page.locator('.drive:last-of-type [data-value="speed"]').text_content()
    assert shown == f"{record.log.speeds[start + 10]:.2f} m/s"
    page.keyboard.press("Space")
    page.wait_for_function(f"Number(document.getElementById('tick').value) > {start + 12}")
    page.keyboard.press("Space")
    assert page.text_content("#play") == "Play"
    stopped = at(page)
    page.wait_for_timeout(300)
    assert at(page) == stopped
    page.keyboard.press("End")
    assert at(page) == max(len(driven.record.ego) for driven in junction) - 1
    page.keyboard.press("Home")
    assert at(page) == 0
    assert said == []


@pytest.mark.slow
def test_the_map_shows_the_detection_with_the_roadside_only(opened, junction):
    """Pink pixels in the right map at a tick at which the other car is heeded; none in the left one."""
    page, _ = opened
    record = junction[0].record
    ticks = [tick for tick, found in enumerate(record.found) if found is not None and found.heeded.any()]
    tick = ticks[len(ticks) // 2]
    page.evaluate(f"t = document.getElementById('tick'); t.value = {tick}; t.dispatchEvent(new Event('input'))")
    pink = """[...document.querySelectorAll('.map')].map(canvas => {
        const rgba = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data
        let count = 0
        for (let k = 0; k < rgba.length; k += 4) count += rgba[k] > 230 && rgba[k + 1] < 110 && rgba[k + 2] > 140
        return count
    })"""
    alone, with_roadside = page.evaluate(pink)
    assert alone == 0
    assert with_roadside > 50
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
