"""What a car is like: body type, size (of CARLA's range), paint and shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import GeometryError


@dataclass(frozen=True)
class BodyShape:
    """Proportions of a body style: x as a share of the length from the centre, z as a share of the height."""

    cowl_x: float  # foot of the windscreen
    screen_top_x: float
    roof_end_x: float
    tail_glass_x: float  # foot of the rear window
    nose_z: float
    cowl_z: float
    deck_z: float  # belt at the rear
    tail_z: float  # upper edge of the tail
    front_taper: float  # share of the half width lost towards the nose
    rear_taper: float
    tumblehome: float  # share of the half width lost from belt to roof
    wheel_radius_m: float
    glazed_to_x: float  # side windows end here
    side_gap_x: tuple[float, ...]  # shut lines of the doors


# Our own choice.
BODY_SHAPES = {
    "hatchback": BodyShape(
        cowl_x=0.225,
        screen_top_x=0.02,
        roof_end_x=-0.36,
        tail_glass_x=-0.475,
        nose_z=0.54,
        cowl_z=0.64,
        deck_z=0.65,
        tail_z=0.58,
        front_taper=0.20,
        rear_taper=0.13,
        tumblehome=0.23,
        wheel_radius_m=0.325,
        glazed_to_x=-0.37,
        side_gap_x=(0.19, -0.06, -0.26),
    ),
    "sedan": BodyShape(
        cowl_x=0.20,
        screen_top_x=0.015,
        roof_end_x=-0.20,
        tail_glass_x=-0.365,
        nose_z=0.52,
        cowl_z=0.63,
        deck_z=0.68,
        tail_z=0.64,
        front_taper=0.20,
        rear_taper=0.15,
        tumblehome=0.25,
        wheel_radius_m=0.335,
        glazed_to_x=-0.27,
        side_gap_x=(0.17, -0.06, -0.24),
    ),
    "suv": BodyShape(
        cowl_x=0.22,
        screen_top_x=0.055,
        roof_end_x=-0.41,
        tail_glass_x=-0.485,
        nose_z=0.55,
        cowl_z=0.62,
        deck_z=0.63,
        tail_z=0.58,
        front_taper=0.16,
        rear_taper=0.08,
        tumblehome=0.20,
        wheel_radius_m=0.375,
        glazed_to_x=-0.40,
        side_gap_x=(0.19, -0.05, -0.25),
    ),
    "van": BodyShape(
        cowl_x=0.36,
        screen_top_x=0.235,
        roof_end_x=-0.485,
        tail_glass_x=-0.497,
        nose_z=0.42,
        cowl_z=0.50,
        deck_z=0.50,
        tail_z=0.47,
        front_taper=0.15,
        rear_taper=0.02,
        tumblehome=0.11,
        wheel_radius_m=0.34,
        glazed_to_x=0.03,
        side_gap_x=(0.32, 0.10, -0.14),
    ),
}

# Length, width and height in metres, smallest and largest of each body type; a van is Class ``Car`` too.
SIZES_M = {
    "hatchback": ((3.63, 1.74, 1.46), (4.32, 1.88, 1.56)),
    "sedan": ((4.40, 1.80, 1.42), (4.95, 2.00, 1.52)),
    "suv": ((4.35, 1.85, 1.62), (5.57, 2.15, 2.05)),
    "van": ((4.44, 1.77, 1.99), (5.60, 2.00, 2.50)),
}
BODY_SHARES = {"hatchback": 0.3, "sedan": 0.3, "suv": 0.25, "van": 0.15}
# Linear RGB albedo of paints and how often they are met.
PAINTS = (
    ((0.60, 0.60, 0.585), 0.22),
    ((0.42, 0.43, 0.45), 0.18),
    ((0.13, 0.14, 0.15), 0.18),
    ((0.015, 0.015, 0.018), 0.16),
    ((0.33, 0.015, 0.018), 0.08),
    ((0.02, 0.06, 0.24), 0.09),
    ((0.03, 0.10, 0.07), 0.03),
    ((0.34, 0.27, 0.19), 0.03),
    ((0.55, 0.30, 0.03), 0.015),
    ((0.16, 0.30, 0.42), 0.015),
)


def axles_x(length: float) -> tuple[float, float]:
    """Places of the front and the rear axle of a car (m), forward of its centre."""
    return length / 2 - (0.60 + 0.055 * length), -length / 2 + (0.42 + 0.09 * length)


@dataclass(frozen=True)
class CarSpec:
    """One car: body type, box size in metres, paint (linear RGB albedo), and four shape parameters in [-1, 1]:
    bonnet length, windscreen rake, belt height, roof taper."""

    body: str
    length: float
    width: float
    height: float
    color: tuple[float, float, float]
    shape: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.body not in BODY_SHAPES:
            raise GeometryError(f"car: unknown body {self.body!r}; known: {', '.join(BODY_SHAPES)}")
        if not min(self.length, self.width, self.height) > 0:
            raise GeometryError(f"car: size must be positive, found {self.length} x {self.width} x {self.height}")

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width, height in metres: dx, dy, dz of the label box."""
        return (self.length, self.width, self.height)


def draw_car(rng: np.random.Generator, body: str | None = None) -> CarSpec:
    """A random car; ``body`` fixes its type."""
    body = body or str(rng.choice(list(BODY_SHARES), p=list(BODY_SHARES.values())))
    low, high = (np.array(s) for s in SIZES_M[body])
    grade = np.clip(rng.uniform() + rng.uniform(-0.15, 0.15, 3), 0.0, 1.0)
    length, width, height = (float(v) for v in low + grade * (high - low))
    return CarSpec(body, length, width, height, _draw_paint(rng, body), tuple(rng.uniform(-1, 1, 4).tolist()))


def _draw_paint(rng: np.random.Generator, body: str) -> tuple[float, float, float]:
    """A paint with slight variation; every second van is white."""
    shares = np.array([share for _, share in PAINTS])
    pick = 0 if body == "van" and rng.uniform() < 0.5 else rng.choice(len(PAINTS), p=shares / shares.sum())
    color = np.array(PAINTS[pick][0]) * rng.uniform(0.85, 1.15)
    return tuple(np.clip(color, 0.01, 0.85).tolist())
