"""Tiny scenes with known outcomes: an empty hall, the ego at 5 m/s, and one pedestrian or vehicle on rails."""

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Perceived
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.garage import GarageLayout, Wall
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.pedestrian_spec import PedestrianSpec
from pcdet_avp.sim.render.lights import Lighting
from pcdet_avp.sim.scenarios.scenario import Scenario, Threat
from pcdet_avp.sim.trajectories import Path, Route, Waypoints

GREY = (0.3, 0.3, 0.3)
ADULT = PedestrianSpec("adult", 1.75, 0.375, 1.0, GREY, GREY, GREY, GREY, GREY)
SEDAN = CarSpec("sedan", 4.6, 1.9, 1.5, GREY)
LANE_Y = -1.7
START_X = -60.0
FRONT_X = START_X + 2.4  # of the ego's bumper at time 0


def hall(*walls: Wall) -> GarageLayout:
    return GarageLayout(-100.0, 2.0, -15.0, -28.0, 7.5, (), (), walls, (), 0)


def pedestrian(points, speed=1.5, start_s=0.0) -> Pedestrian:
    """Walks along points given as metres ahead of the bumper at time 0 and metres to the left of the lane's middle."""
    places = tuple((FRONT_X + ahead, LANE_Y + left) for ahead, left in points)
    return Pedestrian(0, ADULT, Waypoints(places, speed, start_s))


def bystander() -> Pedestrian:
    """Far away for ever."""
    return pedestrian([(60, 9), (60, 10)], start_s=1e6)


def crossing_pedestrian(ahead: float, meet_s: float, speed: float = 1.5) -> Pedestrian:
    """Crosses from the right and is in the middle of the lane at ``meet_s``."""
    return pedestrian([(ahead, -6.0), (ahead, 6.0)], speed, meet_s - 6.0 / speed)


def crossing_car(ahead: float, meet_s: float, speed: float = 5.0) -> Car:
    """Comes straight from the right; its centre is in the middle of the lane at ``meet_s``."""
    path = Path.from_pose(FRONT_X + ahead, LANE_Y - 20.0, np.pi / 2).straight(60.0)
    return Car(0, SEDAN, Route(path, speed, meet_s - 20.0 / speed))


def scene(*actors, first=0.0, end=40.0, release=None, cruising_mps=5.0, layout=None, clear_after_m=40.0):
    """The first gap and the end lie so many metres ahead of the bumper at time 0; so does where actors are released."""
    release_x = None if release is None else FRONT_X + release
    return Scenario(
        name="pedestrian",
        trial=0,
        seed_key=(0, 0),
        cruising_mps=cruising_mps,
        layout=layout or hall(),
        actors=actors,
        lighting=Lighting(()),
        ego_start_x=START_X,
        threats=tuple(Threat(actor.object_id, clear_after_m, release_x) for actor in actors),
        first_x=FRONT_X + first,
        end_x=FRONT_X + end,
    )


class Scripted:
    """Reports the boxes that a table holds for a tick; ``asked`` lists the ticks at which it was asked."""

    def __init__(self, boxes_by_tick=None, always=None):
        self.table, self.always, self.asked = boxes_by_tick or {}, always, []

    def begin(self, scenario, seed_key):
        self.asked = []

    def perceive(self, world, tick, sensor_set):
        self.asked.append(tick)
        boxes = self.table.get(tick, self.always)
        if boxes is None:
            return Perceived.nothing()
        return Perceived(boxes, np.full(len(boxes), "Pedestrian"), np.ones(len(boxes)))


def pedestrian_at(x: float, y: float) -> np.ndarray:
    """(1, 7) in the ego frame."""
    return np.array([[x, y, 0.9, 0.375, 0.375, 1.8, 0.0]])
