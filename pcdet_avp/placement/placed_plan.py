"""A garage's plan with the units of a placement in place of its own, so that data sets, drives and the adaptation of a
network to one site use the sensors that were chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from pcdet_avp.errors import ConfigError
from pcdet_avp.files import write_text
from pcdet_avp.sim.plans.marked_yaml import MarkedYaml

HEAD = "# {plan} with the roadside units of a placement (avp-place). Comments of the original are not kept.\n"


def write_placed_plan(file: Path, plan_file: str | Path, floor: str, units: Sequence[Mapping[str, Any]]) -> Path:
    """Write a plan's file anew with other ``units`` on one floor: those of a member of ``placement.json``'s ``front``
    (metres and degrees in the plan's frame). Other floors keep theirs. ConfigError where there is no such floor."""
    content = MarkedYaml(Path(plan_file)).value
    floors = {each["name"]: each for each in content["floors"]}
    if floor not in floors:
        raise ConfigError(f"{plan_file}: expected a floor {', '.join(floors)}, found {floor!r}")
    names = {unit["id"] for unit in units}
    kept = [mount for mount in floors[floor].get("mounts", ()) if mount["id"] not in names]
    floors[floor]["mounts"] = kept + [_mount(unit) for unit in units]
    floors[floor]["units"] = [_unit(unit) for unit in units]
    body = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    write_text(file, HEAD.format(plan=content["name"]) + body)
    return file


def _mount(unit: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": unit["id"], "at": [unit["x_m"], unit["y_m"]], "height_m": unit["height_m"], "on": unit["on"]}


def _unit(unit: Mapping[str, Any]) -> dict[str, Any]:
    values = {key: unit[key] for key in ("yaw_deg", "pitch_down_deg", "sensors")}
    return {"id": unit["id"], "mount": unit["id"], **values}
