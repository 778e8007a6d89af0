"""OpenSCENARIO read by its library's own reader, OpenDRIVE by arithmetic of its own; both by ASAM's checkers."""

import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.sim.garage import LANE_WIDTH_M
from pcdet_avp.structures.boxes import bev_corners

xosc = pytest.importorskip(
    "scenariogeneration.xosc", reason="needs scenariogeneration: pip install pcdet_avp[episodes]"
)
ASAM = ("asam-qc-opendrive==1.0.0", "asam-qc-openscenarioxml==1.0.0")


@pytest.fixture(scope="module")
def files(junction, tmp_path_factory):
    return FORMATS["xosc"].write(junction, tmp_path_factory.mktemp("xosc") / "e", ExportSettings())


@pytest.fixture(scope="module")
def scenario(files):
    """As scenariogeneration reads it."""
    return xosc.ParseOpenScenario(str(files[1]))


def trajectories(scenario):
    """Times (T,) and reference poses (T, 3) by entity."""
    found = {}
    for group in scenario.storyboard.stories[0].acts[0].maneuvergroup:
        (event,) = group.maneuvers[0].events
        line = event.action[0].action.trajectory.shapes
        poses = [(p.x, p.y, p.h) for p in line.positions]
        found[group.actors.actors[0].entity] = np.array(line.time, float), np.array(poses, float)
    return found


def test_the_scenario_replays_what_was_driven(scenario, junction):
    record = junction[0].record
    (other,) = [user for user in record.users if not user.stands]
    found = trajectories(scenario)
    assert set(found) == {"ego", f"car_{other.object_id}"}
    for name, poses, length in (("ego", record.ego, 4.8), (f"car_{other.object_id}", other.poses, other.size[0])):
        times, places = found[name]
        np.testing.assert_allclose(times, record.log.times, atol=1e-6)
        back = -length / 2 + 0.42 + 0.09 * length  # of the rear axle from the middle, negative
        heading = np.stack([np.cos(places[:, 2]), np.sin(places[:, 2])], -1)
        np.testing.assert_allclose(places[:, :2] - back * heading, poses[:, :2], atol=2e-6)
        np.testing.assert_allclose(places[:, 2], poses[:, 2], atol=1e-6)


def test_boxes_lie_around_the_reference_points_as_they_stood(scenario, junction):
    """The box's middle, seen from the rear axle, plus where the axle stands, is where the parked car stood."""
    record, objects = junction[0].record, {o.name: o.entityobject for o in scenario.entities.scenario_objects}
    parked = [user for user in record.users if user.stands]
    assert len(objects) == len(record.users) + 1
    for user in parked[::7]:
        name = f"car_{user.object_id}"
        box, (teleport,) = objects[name].boundingbox, scenario.storyboard.init.initactions[name]
        at = teleport.position
        middle = at.x + box.center.x * np.cos(at.h), at.y + box.center.x * np.sin(at.h)
        np.testing.assert_allclose(middle, user.poses[0, :2], atol=2e-6)
        size = box.boundingbox
        np.testing.assert_allclose((size.length, size.width, size.height), user.size)


def test_a_reversing_car_looks_where_its_bonnet_points(reversing, tmp_path):
    _, file = FORMATS["xosc"].write(reversing, tmp_path / "r", ExportSettings())
    _, poses = trajectories(xosc.ParseOpenScenario(str(file)))["ego"]
    way = poses[-1, :2] - poses[0, :2]
    assert way @ [np.cos(poses[0, 2]), np.sin(poses[0, 2])] < -1.0


def roads(file):
    """Start, heading, length and element of every road, by id."""
    found = {}
    for road in ElementTree.parse(file).getroot().iter("road"):
        first = road.find("planView/geometry")
        start = np.array([float(first.get("x")), float(first.get("y"))])
        found[road.get("id")] = start, float(first.get("hdg")), float(road.get("length")), road
    return found


def test_roads_lie_where_the_garage_has_them(files, junction):
    layout, found = junction[0].record.scenario.layout, roads(files[0])
    for number, end in (
        ("1", None),
        ("2", (layout.road_end_x, 0.0)),
        ("3", (layout.junction_x, layout.side_road_end_y)),
    ):
        start, heading, length, road = found[number]
        reached = start + length * np.array([np.cos(heading), np.sin(heading)])
        np.testing.assert_allclose(reached, end or (layout.junction_x - 5.0, 0.0), atol=1e-9)
        widths = [float(width.get("a")) for width in road.iter("width")]
        assert widths == [LANE_WIDTH_M, LANE_WIDTH_M]
    connections = list(ElementTree.parse(files[0]).getroot().iter("connection"))
    assert len(connections) == 6  # every way between three roads


def test_objects_stand_where_slots_and_walls_are(files, junction):
    layout, slots, solid = junction[0].record.scenario.layout, [], []
    for start, heading, _, road in roads(files[0]).values():
        along = np.array([np.cos(heading), np.sin(heading)])
        left = np.array([-along[1], along[0]])
        for placed in road.iter("object"):
            at = start + float(placed.get("s")) * along + float(placed.get("t")) * left
            corners = [(float(c.get("u")), float(c.get("v"))) for c in placed.iter("cornerLocal")]
            if placed.get("type") == "parkingSpace":
                slots.append((*at, (heading + float(placed.get("hdg"))) % (2 * np.pi)))
            else:
                solid.append((placed.get("id"), at + np.array([u * along + v * left for u, v in corners])))
    expected = sorted((slot.x, slot.y, slot.heading % (2 * np.pi)) for slot in layout.slots)
    np.testing.assert_allclose(sorted(slots), expected, atol=1e-6)
    boxes = bev_corners(layout.solid_boxes())
    assert len(solid) == len(boxes)
    middles = sorted(corners.mean(0).tolist() for _, corners in solid)
    np.testing.assert_allclose(middles, sorted(box.mean(0).tolist() for box in boxes), atol=1e-6)
    assert Counter(name.partition("_")[0] for name, _ in solid) == {
        "pillar": len(layout.pillars),
        "wall": len(layout.walls),
    }


def test_the_same_episode_gives_the_same_bytes(files, junction, tmp_path):
    """Also as the second file of a process, although the library numbers objects across files."""
    again = FORMATS["xosc"].write(junction, tmp_path / "e", ExportSettings())
    assert [file.read_bytes() for file in again] == [file.read_bytes() for file in files]


@pytest.fixture(scope="module")
def checkers(tmp_path_factory):
    """The folder of ASAM's checkers: AVP_ASAM_QC, or an environment of their own (they pin what we do not)."""
    if folder := os.environ.get("AVP_ASAM_QC"):
        return Path(folder)
    place = tmp_path_factory.mktemp("asam") / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
    pip = subprocess.run(
        [str(place / "bin" / "pip"), "install", "-q", *ASAM], capture_output=True, text=True, check=False
    )
    if pip.returncode:
        shutil.rmtree(place)
        pytest.skip(f"ASAM's checkers cannot be installed here: {pip.stderr.strip().splitlines()[-1]}")
    return place / "bin"


def verdict(checker, file, folder):
    """Rules by status, and the issues found; the exit status says neither."""
    bundle = {"qc_opendrive": "xodrBundle", "qc_openscenario": "xoscBundle"}[checker.name]
    (folder / "config.xml").write_text(
        f'<Config><Param name="InputFile" value="{file}"/><CheckerBundle application="{bundle}">'
        '<Param name="resultFile" value="result.xqar"/></CheckerBundle></Config>'
    )
    subprocess.run([str(checker), "-c", "config.xml"], cwd=folder, capture_output=True, check=True)
    root = ElementTree.parse(folder / "result.xqar").getroot()
    return Counter(rule.get("status") for rule in root.iter("Checker")), [i.attrib for i in root.iter("Issue")]


@pytest.mark.slow
def test_asams_checkers_complete_their_rules_without_an_issue(files, checkers, tmp_path):
    """OpenDRIVE 1.7 leaves out one rule of 23, which is defined from 1.8 on."""
    road_map, scenario = files
    assert verdict(checkers / "qc_opendrive", road_map, tmp_path) == ({"completed": 22, "skipped": 1}, [])
    assert verdict(checkers / "qc_openscenario", scenario, tmp_path) == ({"completed": 17}, [])


@pytest.mark.slow
def test_the_checkers_find_a_fault(files, checkers, tmp_path):
    """A connecting road that two connections have, and an actor without an entity; the exit status is 0."""
    wrong_map, wrong = tmp_path / "wrong.xodr", tmp_path / "wrong.xosc"
    wrong_map.write_text(files[0].read_text().replace('connectingRoad="102"', 'connectingRoad="101"', 1))
    wrong.write_text(files[1].read_text().replace('<EntityRef entityRef="ego"', '<EntityRef entityRef="nobody"', 1))
    assert verdict(checkers / "qc_opendrive", wrong_map, tmp_path)[1]
    assert verdict(checkers / "qc_openscenario", wrong, tmp_path)[1]


def test_a_hall_without_walls_in_which_nobody_else_is(nobody, tmp_path):
    """The map's outermost points are then its roads': the main one's ends at -100 and 2 m, the side road's at -28 m."""
    road_map, scenario = FORMATS["xosc"].write(nobody, tmp_path / "e", ExportSettings(every=0))
    header = ElementTree.parse(road_map).getroot().find("header")
    assert [float(header.get(side)) for side in ("west", "east", "south")] == [-100.0, 2.0, -28.0]
    assert [each.get("name") for each in ElementTree.parse(scenario).getroot().iter("ScenarioObject")] == ["ego"]
