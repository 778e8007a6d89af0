"""DATA_CONFIG.GENERATE.GARAGE and .SCENE: the settings of generated scenes, as a configuration holds them.

``cfgs/dataset_configs/avp_full.yaml`` writes them out with their defaults. Data sets, checkpoints and sweeps that were
made before it did have no such sections, or keys in lower case: an absent key means its default everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from pcdet_avp.config_fields import fields_from
from pcdet_avp.structures.scene_config import EgoZone, GarageConfig, LateSightConfig, MastConfig, SceneConfig

# Of GENERATE: null, or absent, means what data sets were without them.
LATER_KEYS = ("PLAN", "GARAGE_SEED", "MAST", "LATE_SIGHT")
# Keys of GENERATE that a configuration may lack; --set may add them.
OPTIONAL_KEYS = (*LATER_KEYS, "SPLIT", "SOURCES")
# Fields that other keys set.
ELSEWHERE = {
    "GARAGE": (),
    "SCENE": ("frames", "frame_interval_s", "garage", "plan", "garage_seed", "mast", "late_sight"),
}
SECTIONS = {"MAST": MastConfig, "LATE_SIGHT": LateSightConfig}  # of GENERATE that may be absent: then there is none


def scene_config(generate: Mapping[str, Any]) -> SceneConfig:
    """The settings that GENERATE describes; ConfigError for an unknown key or an impossible range."""
    where = "DATA_CONFIG.GENERATE"
    garage = fields_from(GarageConfig, generate.get("GARAGE") or {}, f"{where}.GARAGE")
    scene = fields_from(SceneConfig, generate.get("SCENE") or {}, f"{where}.SCENE", ELSEWHERE["SCENE"])
    if "zones" in scene:
        zones = [fields_from(EgoZone, zone, f"{where}.SCENE.ZONES") for zone in scene["zones"]]
        scene["zones"] = [EgoZone(**_with_tuples(zone)) for zone in zones]
    times = {"frames": generate["FRAMES_PER_SCENE"], "frame_interval_s": float(generate["FRAME_INTERVAL_S"])}
    place = {"plan": generate.get("PLAN"), "garage_seed": generate.get("GARAGE_SEED")}
    place |= {name.lower(): _section(generate, name) for name in SECTIONS}
    return replace(SceneConfig(), garage=GarageConfig(**_with_tuples(garage)), **_with_tuples(scene), **times, **place)


def _section(generate: Mapping[str, Any], name: str) -> MastConfig | LateSightConfig | None:
    """The settings of one of SECTIONS; None where it is absent or null."""
    section, kind = generate.get(name), SECTIONS[name]
    if section is None:
        return None
    return kind(**_with_tuples(fields_from(kind, section, f"DATA_CONFIG.GENERATE.{name}")))


def _with_tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(v) if isinstance(v, Sequence) and not isinstance(v, str) else v for key, v in values.items()}


def as_sections(settings: SceneConfig) -> dict[str, dict[str, Any]]:
    """GARAGE and SCENE of settings, with every key, as plain mappings and lists."""
    values = _in_capitals(asdict(settings))
    return {
        "GARAGE": values["GARAGE"],
        "SCENE": {k: v for k, v in values.items() if k.lower() not in ELSEWHERE["SCENE"]},
    }


def _in_capitals(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key.upper(): _in_capitals(item) for key, item in value.items()}
    return [_in_capitals(item) for item in value] if isinstance(value, tuple | list) else value


DEFAULTS = as_sections(SceneConfig())
SECTION_DEFAULTS = {name: _in_capitals(asdict(kind())) for name, kind in SECTIONS.items()}


def known_name(key: str, above: Sequence[str]) -> str:
    """The key as it is written today: in capitals below GENERATE.GARAGE and .SCENE. ``above``: its sections."""
    below = len(above) >= 2 and above[-2] == "GENERATE" and above[-1] in DEFAULTS
    return key.upper() if below and key.upper() in DEFAULTS[above[-1]] else key


def completed(generate: Mapping[str, Any]) -> dict[str, Any]:
    """GENERATE with LATER_KEYS and every key of GARAGE, SCENE and those SECTIONS that there are, what it lacks at its
    default: for comparisons."""
    given = {name: _renamed(generate.get(name) or {}, name) for name in DEFAULTS}
    sections = {name: {**DEFAULTS[name], **given[name]} for name in DEFAULTS}
    for name, defaults in SECTION_DEFAULTS.items():
        if generate.get(name) is not None:  # an empty section draws masts, none draws none
            sections[name] = {**defaults, **generate[name]}
    return {**dict.fromkeys(LATER_KEYS), **generate, **sections}


def without_defaults(generate: Mapping[str, Any]) -> dict[str, Any]:
    """GENERATE as it was written before its GARAGE and SCENE were: only what differs from a default, in lower case."""
    unset = {key for key in LATER_KEYS if generate.get(key) is None}
    rest = {key: value for key, value in generate.items() if key not in DEFAULTS and key not in unset}
    for name, defaults in DEFAULTS.items():
        given = _renamed(generate.get(name) or {}, name)
        changed = {k.lower(): v for k, v in given.items() if k not in defaults or v != defaults[k]}
        rest |= {name: changed} if changed else {}
    return rest


def _renamed(section: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {known_name(key, ("GENERATE", name)): value for key, value in section.items()}
