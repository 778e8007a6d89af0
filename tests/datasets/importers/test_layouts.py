"""What comes back from the three layouts is the garage that went in; with any convention mistaken, it is not.

``written.py`` writes the layouts by formulas of its own. So that generator and importer cannot share a mistake, the
conventions themselves are tested elsewhere: test_by_hand.py works them out by hand, test_carla_package.py asks CARLA's
own package.
"""

from dataclasses import replace

import numpy as np
import pytest
from datasets.importers.written import FIRST_OBJECT

from pcdet_avp.datasets.importers import axes, carla, carla_scene, dair_v2x, opv2v
from pcdet_avp.datasets.importers.run import open_recording
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.boxes import wrap_angle
from pcdet_avp.structures.pose import Pose

FORMATS = ["opv2v", "dair_v2x", "carla"]
LAST_PLACE_M = 1e-3  # float32 positions of two digits before the point, and four decimals in ascii


def records(format_name, foreign):
    recording = open_recording(format_name, getattr(foreign, format_name))
    return [recording.read(scene.name, frame).record for scene in recording.scenes for frame in scene.frames]


def assert_same_garage(format_name, found, garage):
    for record, frame in zip(found, garage, strict=True):
        ours = record.frame()
        np.testing.assert_allclose(ours.ego.points[:, :3], frame.ego.points[:, :3], atol=LAST_PLACE_M)
        assert_intensity(ours.ego.points, frame.ego.points)
        from_ours, from_theirs = (f.ego_from_infra.apply(f.infra.points[:, :3].astype(float)) for f in (ours, frame))
        np.testing.assert_allclose(from_ours, from_theirs, atol=LAST_PLACE_M)
        assert_same_cameras(ours, frame)
        assert_same_labels(ours.labels, frame.labels, by_id=format_name != "dair_v2x")
        if format_name != "dair_v2x":  # its images are JPEG
            np.testing.assert_array_equal(ours.infra.image, frame.infra.image)
        assert np.abs(ours.ego.image.astype(float) - frame.ego.image).mean() < 8


def assert_intensity(ours, theirs):
    np.testing.assert_allclose(ours[:, 3], theirs[:, 3], atol=0.5 / 255 + 1e-4)


def assert_same_cameras(ours, frame):
    """The pixel of points around the ego, by both agents' cameras."""
    points = np.random.default_rng(0).uniform([4, -8, 0], [40, 8, 3], (60, 3))
    for agent in ("ego", "infra"):
        pixels = []
        for each in (ours, frame):
            pose = Pose.identity() if agent == "ego" else each.ego_from_infra.inverse()
            pixels.append(getattr(each, agent).camera.project(pose.apply(points))[0])
        np.testing.assert_allclose(*pixels, atol=2e-2)


def assert_same_labels(ours, theirs, by_id):
    kept = np.flatnonzero(np.isin(theirs.names, list(set(ours.names))))
    expected = theirs.boxes[kept]
    if by_id:
        order = np.argsort(ours.object_ids)
        ours = ours.select(order)
        np.testing.assert_array_equal(ours.object_ids, FIRST_OBJECT + kept)
    np.testing.assert_array_equal(ours.names, theirs.names[kept])
    np.testing.assert_allclose(ours.boxes[:, :6], expected[:, :6], atol=LAST_PLACE_M)
    np.testing.assert_allclose(wrap_angle(ours.boxes[:, 6] - expected[:, 6]), 0, atol=1e-6)


@pytest.mark.parametrize("format_name", FORMATS)
def test_the_garage_comes_back(format_name, foreign, garage):
    found = records(format_name, foreign)
    assert_same_garage(format_name, found, garage)
    assert {name for record in found for name in record.labels.names} == (
        {"Car", "Pedestrian"} if format_name == "carla" else {"Car"}
    )


def test_carlas_depth_maps_come_back(foreign, garage):
    for record, frame in zip(records("carla", foreign), garage, strict=True):
        for ours, theirs in ((record.ego, frame.ego), (record.units["mast"], frame.infra)):
            known = theirs.depth > 0
            np.testing.assert_allclose(ours.depth[known], theirs.depth[known], atol=1e-3)
            np.testing.assert_allclose(ours.depth[~known], 1000.0)  # the sky: unknown, once written


def test_times_are_seconds_since_the_scene_began(foreign):
    assert [r.time_s for r in records("opv2v", foreign)] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [r.time_s for r in records("dair_v2x", foreign)] == pytest.approx([0.0, 0.1, 0.0, 0.1])
    assert [r.time_s for r in records("carla", foreign)] == pytest.approx([0.0, 0.1, 0.2, 0.3])


# ---------------------------------------------------------------- injected faults


def not_mirrored(monkeypatch):
    monkeypatch.setattr(axes, "MIRROR_Y", np.ones(3))


def mirrored_throughout(monkeypatch):
    """All of it in left-handed axes: the garage's mirror image, which agrees with itself."""

    def left_handed(location, roll_deg, pitch_deg, yaw_deg):
        return pose(np.asarray(location) * [1, -1, 1], roll_deg, pitch_deg, -yaw_deg)

    pose = axes.pose_from_unreal
    for module in (opv2v, carla):
        monkeypatch.setattr(module, "points_from_unreal", np.asarray)
    for module in (opv2v, carla_scene):
        monkeypatch.setattr(module, "pose_from_unreal", left_handed)


def degrees_as_radians(monkeypatch):
    pose = axes.pose_from_unreal
    for module in (opv2v, carla_scene):
        monkeypatch.setattr(
            module, "pose_from_unreal", lambda place, *angles: pose(place, *(np.degrees(a) for a in angles))
        )


def pitch_for_roll(monkeypatch):
    pose = axes.pose_from_unreal
    for module in (opv2v, carla_scene):
        monkeypatch.setattr(module, "pose_from_unreal", lambda place, roll, pitch, yaw: pose(place, pitch, roll, yaw))


def half_sizes_as_full(monkeypatch):
    box = axes.unreal_box
    for module in (opv2v, carla):
        monkeypatch.setattr(module, "unreal_box", lambda pose, centre, extent: box(pose, centre, np.array(extent) / 2))


def centre_forgotten(monkeypatch):
    box = axes.unreal_box
    for module in (opv2v, carla):
        monkeypatch.setattr(module, "unreal_box", lambda pose, centre, extent: box(pose, np.zeros(3), extent))


def offset_forgotten(monkeypatch):
    monkeypatch.setattr(dair_v2x, "offset_of", lambda field: 0.0)


def chain_reversed(monkeypatch):
    read = dair_v2x.repaired_pose

    def backwards(rotation, translation):
        pose, off = read(rotation, translation)
        return pose.inverse(), off

    monkeypatch.setattr(dair_v2x, "repaired_pose", backwards)


def vertices_from_the_rear(monkeypatch):
    box = axes.corner_box
    monkeypatch.setattr(dair_v2x, "corner_box", lambda corners: box(corners[[2, 3, 0, 1, 6, 7, 4, 5]]))


FAULTS = {
    not_mirrored: ("opv2v", "carla"),
    mirrored_throughout: ("opv2v", "carla"),
    degrees_as_radians: ("opv2v", "carla"),
    pitch_for_roll: ("opv2v", "carla"),
    half_sizes_as_full: ("opv2v", "carla"),
    centre_forgotten: ("opv2v", "carla"),
    offset_forgotten: ("dair_v2x",),
    chain_reversed: ("dair_v2x",),
    vertices_from_the_rear: ("dair_v2x",),
}


@pytest.mark.parametrize(("fault", "format_name"), [(fault, name) for fault, names in FAULTS.items() for name in names])
def test_a_mistaken_convention_is_noticed(fault, format_name, foreign, garage, monkeypatch):
    fault(monkeypatch)
    with pytest.raises((AssertionError, RecordError)):
        assert_same_garage(format_name, records(format_name, foreign), garage)


def test_a_mistaken_label_alone_is_noticed(foreign, garage):
    """The comparison itself: a heading turned by half a turn, a box grown by a centimetre."""
    found = records("carla", foreign)
    for change in ([0, 0, 0, 0, 0, 0, np.pi], [0, 0, 0, 0.01, 0, 0, 0]):
        labels = replace(found[0].labels, boxes=found[0].labels.boxes + change)
        with pytest.raises(AssertionError):
            assert_same_garage("carla", [replace(found[0], labels=labels)], garage[:1])
