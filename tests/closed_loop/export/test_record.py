"""The record holds what the loop drove: its own poses, the road users' trajectories, detections where they stood."""

import numpy as np

from pcdet_avp.closed_loop.export.drive import vehicle_alone
from pcdet_avp.closed_loop.sweep.episode_row import Case


def test_the_ego_moves_as_its_speed_says(junction):
    record = junction[0].record
    way = np.hypot(*np.diff(record.ego[:, :2], axis=0).T)
    mean = (record.log.speeds[1:] + record.log.speeds[:-1]) / 2
    np.testing.assert_allclose(way, mean * record.tick_s, atol=2e-3)


def test_road_users_are_the_worlds_at_every_tick(junction):
    driven = junction[0]
    for tick in (0, 60, len(driven.record.ego) - 1):
        users = driven.recording.seek(tick).road_users()
        boxes = np.array([user.boxes()[tick] for user in driven.record.users])
        np.testing.assert_allclose(boxes, users.boxes, atol=1e-9)
        assert [user.object_id for user in driven.record.users] == users.object_ids.tolist()


def test_what_everything_is_known_of_is_found_where_it_stands(junction):
    record = junction[0].record
    (other,) = [user for user in record.users if not user.stands]
    tick = next(tick for tick, found in enumerate(record.found) if found is not None and found.heeded.any())
    (box,) = record.found[tick].boxes[record.found[tick].heeded]
    np.testing.assert_allclose(box, other.boxes()[tick], atol=1e-9)
    assert not any(found.heeded.any() for found in record.alone if found is not None)
    assert set(record.targets_alone) == {8.0}
    assert record.log.targets.min() < 8.0


def test_messages_lie_at_the_ticks_that_perceived(junction):
    record = junction[0].record
    assert [bool(tick) for tick in record.messages] == [found is not None for found in record.found]


def test_the_vehicle_alone_meets_the_other_car(junction):
    with_roadside, alone = (driven.record for driven in junction)
    assert with_roadside.ending() == "passed without a contact"
    assert alone.ending().startswith("contact with the ")
    assert not alone.uses_infra


def test_a_reversing_car_drives_against_its_bonnet(reversing):
    ego = reversing[0].record.ego
    way = ego[-1, :2] - ego[0, :2]
    heading = np.array([np.cos(ego[0, 2]), np.sin(ego[0, 2])])
    assert way @ heading < -1.0


def test_the_mast_is_a_unit_at_its_height(junction):
    (unit,) = junction[0].record.units
    assert (unit.number, unit.x, unit.y, unit.z) == (0, 0.0, 0.0, 7.0)
    assert abs(unit.yaw) == np.pi


def test_whom_to_drive_beside_a_case():
    case = Case("t_junction", "los", "CL+C", 5.0, 3)
    assert vehicle_alone(case).combo == "CL+none"
    assert vehicle_alone(case._replace(combo="C+none")) is None
    assert vehicle_alone(case._replace(combo="any")) is None
