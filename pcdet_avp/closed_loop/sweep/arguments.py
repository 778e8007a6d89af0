"""The sweep that a command line asks for: settings from configurations, and the identity of a sweep."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

from easydict import EasyDict

from pcdet_avp import shipped
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.factory import PerceptionKind, find_perception
from pcdet_avp.closed_loop.perception.faults import MARK, find_fault
from pcdet_avp.closed_loop.perception.link_options import LinkOptions, given_link_options
from pcdet_avp.closed_loop.sweep.journal import SENSORS
from pcdet_avp.closed_loop.sweep.results import IN_TRAINING_GARAGES, MADE_FROM, PERCEPTIONS
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.sweep.training_garages import trials_in_training_garages
from pcdet_avp.config import apply_overrides, config_hash, ignoring, load_config, plain, require
from pcdet_avp.config_check import check_values
from pcdet_avp.deploy.manifest import MANIFEST
from pcdet_avp.deploy.runtime import PRECISIONS, TORCH
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.provenance import provenance
from pcdet_avp.runtime_arguments import check_runtime_arguments, precision_on_cpu
from pcdet_avp.sim.plans.read import read_plan
from pcdet_avp.sim.scenarios.table import ON_PLAN, find_scenario
from pcdet_avp.structures.roadside_unit import mounted_units
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SensorSet

LOOP = "CLOSED_LOOP."
TRIALS = 20  # of a cell, as in the paper
MAP_KEYS = ("POINT_CLOUD_RANGE", "VOXEL_SIZE")
SENSING_KEYS = ("SENSORS", *MAP_KEYS)  # all that perceivers without a network read


def sweep_of(args: argparse.Namespace, loop_file: Path) -> Sweep:
    """The sweep that the arguments of ``tools/safety_eval.py`` ask for."""
    loop_overrides, overrides = split_overrides(args.overrides)
    cfg = _config(args)
    check_values(cfg)
    closed_loop = plain(apply_overrides(load_config(loop_file), loop_overrides))
    EpisodeSettings.from_config(closed_loop)  # raises where a key or a value is wrong
    perceiver = {"data_cfg": _sensing(cfg)}
    scenario, perception = find_scenario(args.scenario), find_perception(args.perception)
    _check_belongs(args, perception)
    if perception.uses_network:
        perceiver |= _network(args, overrides)
    combos = _named_combos(args.combos)
    _check_fault(perception.name, combos)
    if perception.uses_sensors:
        _check_units_on_plan(scenario.name, cfg.DATA_CONFIG, combos)
    return Sweep(
        scenario=scenario.name,
        perception=perception.name,
        combos=combos,
        speeds=tuple(dict.fromkeys(float(f"{speed:.12g}") for speed in args.speeds)),  # as files' names have them
        trials=args.trials or TRIALS,
        seed=args.seed,
        perceiver=perceiver,
        closed_loop=closed_loop,
        identity=_identities(perception, cfg, perceiver) | _plan_identity(scenario.name),
        search=args.search,
    )


def _config(args: argparse.Namespace) -> EasyDict:
    """The configuration that is driven with: ``--set`` without the loop's keys, and ``--ignore_config``."""
    overrides = list(split_overrides(args.overrides)[1])
    return ignoring(apply_overrides(load_config(args.cfg), overrides), args.ignore_config)


def _sensing(cfg: EasyDict) -> dict[str, Any]:
    """What a perceiver without a network reads of DATA_CONFIG, in plain values; ConfigError where a unit cannot be."""
    data_cfg = {key: plain(require(cfg, f"DATA_CONFIG.{key}")) for key in SENSING_KEYS}
    if (units := cfg.DATA_CONFIG.get("ROADSIDE_UNITS")) is not None:
        mounted_units(units)
        data_cfg["ROADSIDE_UNITS"] = plain(units)
    return data_cfg


def _check_belongs(args: argparse.Namespace, perception: PerceptionKind) -> None:
    """ConfigError where something was given that the perception has no use for."""
    if not perception.uses_network and _network_options(args):
        raise ConfigError(
            "--ckpt, --runtime, --exported, --precision, --ignore_config, --link and its options belong to "
            f"--perception model, found {perception.name}"
        )
    if args.combos != "all" and not perception.uses_sensors:
        raise ConfigError(
            f"--combos, --combo: perception {perception.name!r} is the same with every sensor set; expected none to be "
            f"named, found {args.combos!r}"
        )


def _named_combos(text: str) -> tuple[str, ...]:
    """Names between commas, each once, in their order; ``all``."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    return tuple(SENSOR_SETS) if names == ("all",) else tuple(dict.fromkeys(names))


def _check_fault(perception: str, combos: tuple[str, ...]) -> None:
    """ConfigError where a fault changes nothing for any combination: a healthy table would pass for a faulty one."""
    _, mark, name = perception.partition(MARK)
    sources = find_fault(name).sources if mark else ()
    if mark and combos and not any({*SensorSet.parse(combo).sources} & {*sources} for combo in combos):
        raise ConfigError(
            f"--fault {name}: expected a combination with {' or '.join(sources)}, found {', '.join(combos)}, for which "
            "it changes nothing"
        )


def _check_units_on_plan(scenario: str, data_cfg: dict, combos: tuple[str, ...]) -> None:
    """ConfigError where roadside units would stand on a plan that has none, or at places of a drawn garage."""
    _, on_plan, file = scenario.partition(ON_PLAN)
    if not on_plan:
        return
    if data_cfg.get("ROADSIDE_UNITS") is not None:
        raise ConfigError(f"DATA_CONFIG.ROADSIDE_UNITS: places in a drawn garage; expected none with the plan {file}")
    floor, served = read_plan(file).floors[0], [name for name in combos if SensorSet.parse(name).uses_infra]
    if served and not floor.units:
        raise ConfigError(
            f"{file}: floor {floor.name!r}: expected a roadside unit (units: ...) for {', '.join(served)}, found none; "
            "--combos C+none,CL+none, or --combo C+none, do without"
        )


def _network(args: argparse.Namespace, overrides: tuple[str, ...]) -> dict[str, Any]:
    """What ``model`` alone is built from."""
    options = given_link_options(args)
    LinkOptions.of(args.link, options)  # raises if they conflict
    check_runtime_arguments(args)
    # Absolute: a worker elsewhere must not take another file of the same name for it.
    files = {"cfg_file": str(shipped.find_config(args.cfg)), "overrides": overrides}
    files |= {**_weights(args), "ignore_config": tuple(args.ignore_config)}
    files |= {"precision": precision_on_cpu(args)}  # chosen once, here: all workers and a resumed sweep agree
    return {**files, "runtime": args.runtime, "link": args.link, "options": options}


def _weights(args: argparse.Namespace) -> dict[str, str]:
    """The checkpoint, or the folder of an exported network, and a hash that changes with the weights."""
    if args.runtime != TORCH:
        folder = args.exported.absolute()
        return {"ckpt": str(folder), "ckpt_sha256": file_hash(folder / MANIFEST)}
    ckpt = choose_checkpoint(args.ckpt, args.cfg, RunFolder.of(args.cfg).checkpoints, print).absolute()
    return {"ckpt": str(ckpt), "ckpt_sha256": file_hash(ckpt)}


def _network_options(args: argparse.Namespace) -> bool:
    """Whether anything was given that belongs to ``model`` alone."""
    given = (args.ckpt, args.exported, args.precision != PRECISIONS[0], args.ignore_config, given_link_options(args))
    return any(given) or args.link != "ideal" or args.runtime != TORCH


def split_overrides(words: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """The pairs of ``--set`` whose keys begin with CLOSED_LOOP (without that), and all others."""
    pairs = [words[i : i + 2] for i in range(0, len(words), 2)]
    loop = [word for pair in pairs if pair[0].startswith(LOOP) for word in (pair[0].removeprefix(LOOP), *pair[1:])]
    return loop, tuple(word for pair in pairs if not pair[0].startswith(LOOP) for word in pair)


def _plan_identity(scenario: str) -> dict[str, Any]:
    """The plan that a scenario plays on, by its content; another one of the same name is another sweep."""
    _, on_plan, plan = scenario.partition(ON_PLAN)
    return {scenario: hashlib.sha256(Path(read_plan(plan).file).read_bytes()).hexdigest()} if on_plan else {}


def _identities(perception: PerceptionKind, cfg: dict, perceiver: dict[str, Any]) -> dict[str, Any]:
    """By name what must agree: what a perception depends on, and the sensors, which all of a folder that have any
    share: a network's crash that line of sight avoids is the network's fault only with the same ones."""
    sensors = {SENSORS: perceiver["data_cfg"]} if perception.uses_sensors else {}
    return {perception.name: _identity(perception, cfg, perceiver)} | sensors


def _identity(perception: PerceptionKind, cfg: dict, perceiver: dict[str, Any]) -> dict[str, Any]:
    """What the results of a perception depend on, beside the seed and the loop."""
    if not perception.uses_map:
        return {}
    if not perception.uses_sensors:
        return {"data_cfg": {key: perceiver["data_cfg"][key] for key in MAP_KEYS}}
    if not perception.uses_network:
        return {"data_cfg": perceiver["data_cfg"]}
    identity = {"config_hash": config_hash(cfg), "weights": perceiver["ckpt_sha256"]}
    identity |= {key: perceiver[key] for key in ("link", "options")}
    # Sweeps from before there was a choice of these go on.
    identity |= {"runtime": perceiver["runtime"]} if perceiver["runtime"] != TORCH else {}
    in_float32 = perceiver["precision"] == "float32"
    return identity | ({"use_amp": False} if in_float32 else {"precision": perceiver["precision"]})


def file_hash(path: Path) -> str:
    """SHA-256 of a checkpoint file; raises where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from error


def known_trials(args: argparse.Namespace, sweep: Sweep) -> list[int]:
    """The trials of a network's sweep that play in buildings of its training data."""
    if not find_perception(sweep.perception).uses_network:
        return []
    return trials_in_training_garages(_config(args).DATA_CONFIG, sweep.scenario, sweep.seed, sweep.trials)


def sweep_meta(args: argparse.Namespace, sweep: Sweep, started: float) -> dict[str, Any]:
    """Provenance of a sweep's figures, and the settings of the loop."""
    weights = sweep.identity[sweep.perception].get("weights")
    meta = provenance(_config(args), Path(args.cfg).stem, seed=sweep.seed, weights_hash=weights, started=started)
    meta |= {
        IN_TRAINING_GARAGES: known_trials(args, sweep),
        "closed_loop": dict(sweep.closed_loop),
        "search": sweep.search,
        "precision": sweep.perceiver.get("precision"),
        "runtime": args.runtime,
        "link": args.link,
        "link_options": given_link_options(args),
    }
    return meta | {PERCEPTIONS: {sweep.perception: {key: meta[key] for key in MADE_FROM}}}
