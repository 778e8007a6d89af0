"""Which trials are driven in a garage that a network was trained in.

Generated data sets and episodes draw their garages alike, from a seed and a number: scene k of a data set that was made
with seed S stands in the same building as trial k of a sweep with seed S (roads, slots, pillars, walls; other parked
cars, people and light). Where scene k is one of the training split, the network knows that building. For a perception
without a network it does not matter. Seeds of certificates, from 1,000,000 on, are those of no data set of ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pcdet_avp.config_scenes import scene_config
from pcdet_avp.datasets.avp.splits import protocol_of
from pcdet_avp.generate import plan
from pcdet_avp.sim.scenarios.table import ON_PLAN
from pcdet_avp.structures.scene_config import GarageConfig

TRAIN = "train"


def trials_in_training_garages(data_cfg: Mapping[str, Any], scenario: str, seed: int, trials: int) -> list[int]:
    """The trials below ``trials`` whose garage is that of a training scene of DATA_CONFIG; none on a garage's plan."""
    generate = data_cfg.get("GENERATE")
    if not generate or generate.get("SEED") != seed or generate.get("PLAN") or ON_PLAN in scenario:
        return []
    settings = scene_config(generate)
    if settings.garage != GarageConfig() or settings.garage_seed is not None:  # other buildings
        return []
    manifest = plan({**data_cfg, "ROADSIDE_UNITS": None})
    trained = {frame.partition("/")[0] for frame in manifest.frame_ids(TRAIN, protocol_of(data_cfg))}
    return [trial for trial, scene in enumerate(manifest.scenes[:trials]) if scene.name in trained]


def sentence(trials: Sequence[int], seed: int) -> str:
    """For the terminal and for reports."""
    named = ", ".join(map(str, trials[:20])) + (" ..." if len(trials) > 20 else "")
    return (
        f"trials {named} play in buildings that the network was trained in, since its data were drawn from seed {seed} "
        f"as well (cars, people and light are others); --seed {seed + 1} plays in buildings that it never saw"
    )
