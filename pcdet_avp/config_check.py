"""The values and keys of a whole configuration, checked in one place, so that a tool refuses the wrong ones before
anything starts.

A key that no rule knows is an error that names the near ones: otherwise a misspelt one would be left out in silence.
Below a section whose NAME is a class of the user's own any key may stand. Every number anywhere must be finite.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from typing import Any

from pcdet_avp.config_keys import LEAVES, RULES, is_foreign
from pcdet_avp.config_rules import SECTION, Rule
from pcdet_avp.errors import ConfigError


def check_values(cfg: Mapping) -> None:
    """ConfigError for the first key that no rule knows, or whose value it does not allow."""
    for key, value, pattern in _leaves(cfg, "", ""):
        rule = RULES.get(pattern) or _of_section(RULES, pattern)
        if rule is None:
            raise ConfigError(f"configuration: unknown key {key}; {_near(pattern, RULES)}")
        if not rule.allows(value):
            raise ConfigError(f"configuration: {key}: expected {rule.expected}, found {value!r}")
        _refuse_endless(key, value)


def _leaves(value: Any, key: str, pattern: str) -> Iterator[tuple[str, Any, str]]:
    """Key, value and pattern (``*`` for the number of an item) of every value that is no section of its own."""
    if isinstance(value, Mapping) and value and pattern not in LEAVES and not is_foreign(pattern, value):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}".lstrip("."), f"{pattern}.{name}".lstrip("."))
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{key}.{number}", f"{pattern}.*")
    else:
        yield key, value, pattern


def _of_section(rules: Mapping[str, Rule], pattern: str) -> Rule | None:
    """The rule for a section that is null or empty, or of a class of the user's own."""
    return SECTION if any(name.startswith(f"{pattern}.") for name in rules) else None


def _refuse_endless(key: str, value: Any) -> None:
    if isinstance(value, Mapping):
        for name, item in value.items():
            _refuse_endless(f"{key}.{name}", item)
    elif isinstance(value, list | tuple):
        for number, item in enumerate(value):
            _refuse_endless(f"{key}.{number}", item)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"configuration: {key}: expected a finite number, found {value}")


def _near(pattern: str, rules: Mapping[str, Rule]) -> str:
    section, _, name = pattern.rpartition(".")
    start = f"{section}." if section else ""
    beside = {key.removeprefix(start).partition(".")[0] for key in rules if key.startswith(start)}
    close = difflib.get_close_matches(name, beside, n=3, cutoff=0.5)
    return f"near ones: {', '.join(close)}" if close else f"known there: {', '.join(sorted(beside)) or 'none'}"
