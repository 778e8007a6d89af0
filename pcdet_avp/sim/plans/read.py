"""Reads a garage's plan: YAML by plan.schema.json. Each mistake is one line with the file's line number."""

from __future__ import annotations

import difflib
import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

from pcdet_avp import shipped
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.plans.build import build_floor
from pcdet_avp.sim.plans.check import problems
from pcdet_avp.sim.plans.floor import Plan
from pcdet_avp.sim.plans.marked_yaml import MarkedYaml, text

SCHEMA = Path(__file__).with_name("plan.schema.json")


def read_plan(file: str | Path) -> Plan:
    """The plan of a file in the working folder, or of one that comes with the package.

    ConfigError for the first mistake: not YAML, not by the schema, or impossible (see ``check``).
    """
    plan = parse_plan(file)
    for line, message in (found for floor in plan.floors for found in problems(floor)):
        raise ConfigError(f"{plan.file}: line {line}: {message}")
    return plan


@lru_cache(maxsize=4)
def cached_plan(file: str) -> Plan:
    """``read_plan`` for callers that ask again and again, such as workers; a file must not change meanwhile."""
    return read_plan(file)


def parse_plan(file: str | Path) -> Plan:
    """The plan as it is written, its geometry not yet checked; ConfigError where the schema does not allow it."""
    path = shipped.find_config(file)
    marked = MarkedYaml(path)
    _check_schema(marked)
    names = [floor["name"] for floor in marked.value["floors"]]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise marked.error(marked.line(("floors", k, "name")), f"floor {name!r} is given twice")
    floors = tuple(build_floor(marked, k) for k in range(len(names)))
    return Plan(marked.value["name"], floors, str(path))


def _check_schema(marked: MarkedYaml) -> None:
    """ConfigError for the mistake that stands first in the file."""
    from jsonschema import Draft202012Validator
    from jsonschema.validators import extend

    _refuse_endless(marked, marked.value, ())
    # To the standard 11.0 is an integer, too, but nothing can be counted by it.
    whole = Draft202012Validator.TYPE_CHECKER.redefine("integer", lambda _, value: type(value) is int)
    validator = extend(Draft202012Validator, type_checker=whole)(json.loads(SCHEMA.read_text()))
    found = [_explained(error) for error in validator.iter_errors(marked.value)]
    if found:
        where, message = min(found, key=lambda each: marked.line(each[0]))
        raise marked.error(marked.line(where), f"{text(where)}: {message}")


def _refuse_endless(marked: MarkedYaml, value: Any, where: tuple) -> None:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        _refuse_endless(marked, item, (*where, key))
    if isinstance(value, float) and not math.isfinite(value):
        raise marked.error(marked.line(where), f"{text(where)}: expected a finite number, found {value}")


def _explained(error) -> tuple[tuple, str]:
    """Where a mistake is, and what was expected and found there."""
    where, value, rule = tuple(error.absolute_path), error.instance, error.validator_value
    if error.validator == "additionalProperties":
        known = error.schema["properties"]
        key = next(key for key in value if key not in known)
        near = difflib.get_close_matches(key, known, n=2, cutoff=0.5)
        return (*where, key), f"unknown key; {'near ones' if near else 'known'}: {', '.join(near or known)}"
    if error.validator == "required":
        return where, f"missing key {next(key for key in rule if key not in value)!r}"
    if error.validator == "oneOf":
        if not isinstance(value, dict):
            return where, f"expected line_m, or arc_deg and radius_m, found {value!r:.60}"
        return where, f"expected line_m, or arc_deg and radius_m, found {', '.join(value) or 'nothing'}"
    expected = {
        "type": lambda: f"{rule}",
        "enum": lambda: f"one of {', '.join(map(str, rule))}",
        "const": lambda: f"{rule}",
        "minimum": lambda: f"{rule} or more",
        "exclusiveMinimum": lambda: f"more than {rule}",
        "maximum": lambda: f"{rule} or less",
        "minItems": lambda: f"at least {rule} items",
        "maxItems": lambda: f"at most {rule} items",
        "anyOf": lambda: "a height above 0, or two of them",
    }.get(error.validator)
    return where, f"expected {expected()}, found {value!r:.60}" if expected else f"{error.message:.120}"
