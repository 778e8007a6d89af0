"""What a pedestrian is like: adult or child, height, label box and clothes.

The label box is CARLA's capsule box, not the swinging mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import GeometryError

# Height of the body and side of its square label box, metres (lowest, highest).
HEIGHT_M = {"adult": (1.6, 1.9), "child": (1.1, 1.3)}
BOX_SIDE_M = {"adult": (0.375, 0.375), "child": (0.375, 0.5)}
CHILD_SHARE = 0.25
Color = tuple[float, float, float]
# Linear RGB albedos.
TOPS = ((0.02, 0.02, 0.025), (0.5, 0.5, 0.48), (0.03, 0.05, 0.16), (0.30, 0.03, 0.03), (0.06, 0.12, 0.05),
        (0.45, 0.30, 0.06), (0.14, 0.14, 0.15), (0.10, 0.20, 0.32), (0.30, 0.13, 0.18), (0.55, 0.22, 0.03))  # fmt: skip
BOTTOMS = ((0.02, 0.03, 0.07), (0.015, 0.015, 0.017), (0.10, 0.10, 0.11), (0.20, 0.16, 0.10), (0.05, 0.09, 0.16))
HAIRS = ((0.01, 0.008, 0.006), (0.05, 0.025, 0.012), (0.16, 0.09, 0.03), (0.30, 0.29, 0.28), (0.08, 0.02, 0.008))
SKINS = ((0.55, 0.34, 0.24), (0.42, 0.24, 0.15), (0.24, 0.12, 0.07), (0.09, 0.045, 0.03))
SHOES = ((0.01, 0.01, 0.01), (0.5, 0.5, 0.5), (0.08, 0.04, 0.02))


@dataclass(frozen=True)
class PedestrianSpec:
    """One person: height and label box side in metres, girth relative to the average, colours (linear RGB)."""

    kind: str
    height: float
    box_side: float
    build: float
    top: Color
    bottom: Color
    hair: Color
    skin: Color
    shoes: Color
    long_sleeves: bool = True
    long_trousers: bool = True
    long_hair: bool = False
    backpack: bool = False

    def __post_init__(self) -> None:
        if self.kind not in HEIGHT_M:
            raise GeometryError(f"pedestrian: unknown kind {self.kind!r}; known: {', '.join(HEIGHT_M)}")
        if not min(self.height, self.box_side, self.build) > 0:
            found = f"{self.height}, {self.box_side}, {self.build}"
            raise GeometryError(f"pedestrian: height, box side and build must be positive, found {found}")

    @property
    def size(self) -> tuple[float, float, float]:
        """dx, dy, dz of the label box in metres."""
        return (self.box_side, self.box_side, self.height)


def draw_pedestrian(
    rng: np.random.Generator, kind: str | None = None, child_share: float = CHILD_SHARE
) -> PedestrianSpec:
    """A random person; ``kind`` fixes adult or child."""
    kind = kind or ("child" if rng.uniform() < child_share else "adult")

    def color(palette) -> Color:
        return tuple(np.clip(np.array(palette[rng.integers(len(palette))]) * rng.uniform(0.7, 1.4), 0, 0.8).tolist())

    return PedestrianSpec(
        kind,
        height=float(rng.uniform(*HEIGHT_M[kind])),
        box_side=float(rng.uniform(*BOX_SIDE_M[kind])),
        build=float(np.clip(rng.normal(1.0, 0.09), 0.82, 1.25)),
        **{name: color(p) for name, p in zip(("top", "bottom", "hair", "skin", "shoes"), PALETTES, strict=True)},
        long_sleeves=bool(rng.uniform() < 0.7),
        long_trousers=bool(rng.uniform() < (0.9 if kind == "adult" else 0.6)),
        long_hair=bool(rng.uniform() < 0.4),
        backpack=bool(rng.uniform() < 0.25),
    )


PALETTES = (TOPS, BOTTOMS, HAIRS, SKINS, SHOES)
