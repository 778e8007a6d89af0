"""Cars that stand in slots, drive along the road, or turn at the junction: where they may be, drawn at random."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout, Slot
from pcdet_avp.sim.meshes.car_spec import CarSpec, draw_car
from pcdet_avp.sim.plans.floor import FloorLayout, from_axes
from pcdet_avp.sim.trajectories import Path, Route, Standing

LANE_OFFSET_M = LANE_WIDTH_M / 2
SLOT_CLEARANCE_M = 0.25  # parked cars keep this far from their slot's long sides where they can
FITTING_TRIES = 20  # cars drawn for a small slot before a hatchback is taken
ROAD_MARGIN_M = 3.2  # a driven car's centre stays this far from the ends of the road
LEFT_TURN_RADIUS_M = (5.0, 6.5)
RIGHT_TURN_RADIUS_M = (2.6, 3.2)  # tighter, or the inner rear wheel meets the corner pillar
MANOEUVRES = {"exit_left": 0.5, "exit_right": 0.12, "enter_right": 0.15, "enter_left": 0.13, "wait_to_exit": 0.1}


def draw_parked(rng: np.random.Generator, layout: GarageLayout | FloorLayout, occupancy: float) -> dict[Slot, Car]:
    """Each slot holds a car with probability ``occupancy``; object ids count from 0."""
    slots = [slot for slot in layout.slots if rng.random() < occupancy]
    specs = [_draw_fitting(rng, slot) for slot in slots]
    return {
        slot: parked_in(rng, slot, spec, number) for number, (slot, spec) in enumerate(zip(slots, specs, strict=True))
    }


def _draw_fitting(rng: np.random.Generator, slot: Slot) -> CarSpec:
    """A car that fits its slot; those of the paper's size hold every one, so the first is taken there."""
    for _ in range(FITTING_TRIES):
        spec = draw_car(rng)
        if spec.length <= slot.depth - SLOT_CLEARANCE_M / 2 and spec.width <= slot.width - SLOT_CLEARANCE_M:
            return spec
        if (slot.width, slot.depth) == (SLOT_WIDTH_M, SLOT_DEPTH_M):
            return spec
    return draw_car(rng, "hatchback")


def parked_in(rng: np.random.Generator, slot: Slot, spec: CarSpec, object_id: int) -> Car:
    """A car that stands in a slot."""
    return Car(object_id, spec, _parked_pose(rng, slot, spec))


def _parked_pose(rng: np.random.Generator, slot: Slot, spec: CarSpec) -> Standing:
    """Nose or tail to the road, a little off the middle of the slot and a little askew."""
    aside = max((slot.width - spec.width) / 2 - SLOT_CLEARANCE_M, 0.0)
    along = max((slot.depth - spec.length) / 2 - SLOT_CLEARANCE_M / 2, 0.0)
    right = np.clip(rng.normal(0, 0.15), -aside, aside)
    inwards = along * (2 * rng.beta(0.5, 0.5) - 1)  # few in the middle: most are driven right in, or just in
    turned = np.pi if rng.random() < 0.5 else 0.0
    yaw = slot.heading + turned + float(np.clip(rng.normal(0, 0.015), -0.03, 0.03))
    if abs(slot.heading) == np.pi / 2:  # drawn garages keep the very bytes that they always had
        return Standing(float(slot.x + right), float(slot.y + inwards), yaw)
    return Standing(*from_axes(slot, inwards, -right), yaw)


def draw_lane_route(rng: np.random.Generator, layout: GarageLayout, near_x: float, same_way: bool) -> Route:
    """Along the ego's lane (``same_way``) or the opposite one; the car is at about ``near_x`` at time 0."""
    low, high = layout.road_start_x + ROAD_MARGIN_M, layout.road_end_x - ROAD_MARGIN_M - 1.5
    x, speed = float(np.clip(near_x, low, high)), float(rng.uniform(1.5, 7.0))
    y = float(np.clip(rng.normal(0, 0.12), -0.3, 0.3))
    if same_way:
        return Route(Path.from_pose(x, y - LANE_OFFSET_M, 0.0).straight(high - x), speed)
    return Route(Path.from_pose(x, y + LANE_OFFSET_M, np.pi).straight(x - low), speed)


def draw_junction_route(rng: np.random.Generator, layout: GarageLayout, middle_s: float) -> Route | Standing:
    """A car that leaves or enters the side road and is on the way there, or turning, at time ``middle_s``."""
    manoeuvre = rng.choice(list(MANOEUVRES), p=list(MANOEUVRES.values()))
    if manoeuvre == "wait_to_exit":
        return Standing(layout.exit_lane_x, float(rng.uniform(-16.0, -6.0)), np.pi / 2)
    radius = float(rng.uniform(*(LEFT_TURN_RADIUS_M if manoeuvre.endswith("left") else RIGHT_TURN_RADIUS_M)))
    path = JUNCTION_PATHS[manoeuvre](layout, radius)
    speed = float(rng.uniform(1.5, 7.0))
    turn_ends = path.segments[1].length + path.segments[2].length
    return Route(path, speed, middle_s - float(rng.uniform(0.0, turn_ends)) / speed)


def exit_left(layout: GarageLayout, radius: float) -> Path:
    """Out of the side road, across the ego's lane, into the opposite one."""
    y = layout.side_road_end_y + ROAD_MARGIN_M
    path = Path.from_pose(layout.exit_lane_x, y, np.pi / 2).straight(LANE_OFFSET_M - radius - y)
    return path.arc(radius, np.pi / 2).straight(layout.exit_lane_x - radius - layout.road_start_x - ROAD_MARGIN_M)


def exit_right(layout: GarageLayout, radius: float) -> Path:
    """Out of the side road into the ego's lane, towards the mast."""
    y = layout.side_road_end_y + ROAD_MARGIN_M
    path = Path.from_pose(layout.exit_lane_x, y, np.pi / 2).straight(-LANE_OFFSET_M - radius - y)
    return path.arc(radius, -np.pi / 2).straight(-ROAD_MARGIN_M - layout.exit_lane_x - radius)


def enter_right(layout: GarageLayout, radius: float) -> Path:
    """The path from the ego's lane into the side road."""
    approach = 20.0
    path = Path.from_pose(layout.entry_lane_x - radius - approach, -LANE_OFFSET_M, 0.0).straight(approach)
    path = path.arc(radius, -np.pi / 2)
    return path.straight(-LANE_OFFSET_M - radius - layout.side_road_end_y - ROAD_MARGIN_M)


def enter_left(layout: GarageLayout, radius: float) -> Path:
    """The path from the opposite lane, on the mast's side of the junction, into the side road."""
    start = -ROAD_MARGIN_M
    path = Path.from_pose(start, LANE_OFFSET_M, np.pi).straight(start - layout.entry_lane_x - radius)
    path = path.arc(radius, np.pi / 2)
    return path.straight(LANE_OFFSET_M - radius - layout.side_road_end_y - ROAD_MARGIN_M)


JUNCTION_PATHS = {
    "exit_left": exit_left,
    "exit_right": exit_right,
    "enter_right": enter_right,
    "enter_left": enter_left,
}
