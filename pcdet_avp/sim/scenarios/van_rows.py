"""Rows of parked vehicles that hide a pedestrian who steps out: for ``pedestrian_late``.

Every bay begins, as the ego comes, with a van whose tail stands out into the road; the rest are low cars, driven
right in, over which the mast looks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, GarageLayout, Slot
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.scenarios.traffic import SLOT_CLEARANCE_M
from pcdet_avp.sim.trajectories import Standing

Parked = dict[Slot, Car]
CLOSE_BEHIND_M = 0.4  # of a pedestrian's middle from the van's flank


def vans_first(rng: np.random.Generator, out_m: tuple[float, float], layout: GarageLayout, parked: Parked) -> Parked:
    """Other vehicles in the places of ``parked``; vans' tails stand ``out_m`` (range) beyond their slots."""
    firsts = _bay_firsts(layout)
    return {
        slot: _van(rng, car, slot, out_m) if slot in firsts else _low_car(rng, car, slot)
        for slot, car in parked.items()
    }


def _bay_firsts(layout: GarageLayout) -> set[Slot]:
    """The slots that come first in their bays on the ego's way, and have a neighbour."""
    pairs = layout.neighbours()
    return {near for near, _ in pairs} - {far for _, far in pairs}


def _van(rng: np.random.Generator, car: Car, slot: Slot, out_m: tuple[float, float]) -> Car:
    spec = draw_car(rng, "van")
    return _standing(replace(car, spec=spec), slot, LANE_WIDTH_M - rng.uniform(*out_m) + spec.length / 2)


def _low_car(rng: np.random.Generator, car: Car, slot: Slot) -> Car:
    spec = draw_car(rng, "hatchback")
    return _standing(
        replace(car, spec=spec), slot, LANE_WIDTH_M + SLOT_DEPTH_M - SLOT_CLEARANCE_M / 2 - spec.length / 2
    )


def _standing(car: Car, slot: Slot, from_axis_m: float) -> Car:
    """Nose inwards, its middle so far from the road's axis."""
    y = float(np.sign(slot.y) * from_axis_m)
    return replace(car, trajectory=Standing(car.trajectory.x, y, slot.heading))


def places_behind_vans(layout: GarageLayout, parked: Parked) -> np.ndarray:
    """(G, 3) x, y, heading: close behind every bay's van as the ego comes, level with its tail."""
    vans = [parked[slot] for slot in sorted(_bay_firsts(layout), key=lambda slot: slot.x) if slot in parked]
    return np.array([_place(van) for van in vans]).reshape(-1, 3)


def _place(van: Car) -> tuple[float, float, float]:
    pose, side = van.trajectory, np.sign(van.trajectory.y)
    x, tail = pose.x + van.spec.width / 2 + CLOSE_BEHIND_M, abs(pose.y) - van.spec.length / 2
    return x, side * tail, side * np.pi / 2
