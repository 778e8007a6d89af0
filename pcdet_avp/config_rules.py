"""What the values of a configuration may be, in one place, so that a tool refuses the rest before anything starts.

A key that no rule knows is an error that names the near ones: otherwise a misspelt one would be left out in silence.
Below a section whose NAME is a class of the user's own, and below GENERATE.GARAGE and GENERATE.SCENE, whose keys the
generator checks, any key may stand. Every number anywhere must be finite.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pcdet_avp.errors import ConfigError


@dataclass(frozen=True)
class Rule:
    """What a value may be; of a list, each item, and so on down, where ``length`` says that it is one."""

    accepts: Callable[[Any], bool]
    expected: str
    length: int | None = None  # of a list; 0: any length but 0, None: no list
    optional: bool = False  # whether null may stand for it

    def allows(self, value: Any) -> bool:
        if value is None:
            return self.optional
        if self.length is None:
            return self.accepts(value)
        if not isinstance(value, list) or (len(value) != self.length if self.length else not value):
            return False
        return self._items(value)

    def _items(self, value: list) -> bool:
        return all(self._items(item) if isinstance(item, list) else self.accepts(item) for item in value)

    def list_of(self, length: int = 0) -> Rule:
        count = f"{length}" if length else "one or more"
        return Rule(self.accepts, f"a list of {count}, each {self.expected}", length, self.optional)

    def or_null(self) -> Rule:
        return Rule(self.accepts, f"{self.expected}, or null", self.length, True)

    def per_class(self) -> Rule:
        """One value for all classes, or one for each."""
        return Rule(
            lambda value: all(map(self.accepts, value.values())) if isinstance(value, Mapping) else self.accepts(value),
            f"{self.expected}, or one for each class",
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


SECTION = Rule(lambda value: isinstance(value, Mapping), "a section of keys", optional=True)
ANY = Rule(lambda value: True, "anything", optional=True)
TEXT = Rule(lambda value: isinstance(value, str), "text")
NAMES = Rule(lambda value: isinstance(value, list) and all(isinstance(name, str) for name in value), "a list of names")
FLAG = Rule(lambda value: isinstance(value, bool), "true or false")
NUMBER = Rule(_is_number, "a number")
POSITIVE = Rule(lambda value: _is_number(value) and value > 0, "a number above 0")
FROM_0 = Rule(lambda value: _is_number(value) and value >= 0, "0 or a number above it")
SHARE = Rule(lambda value: _is_number(value) and 0 <= value <= 1, "a number from 0 to 1")
SHARE_ABOVE_0 = Rule(lambda value: _is_number(value) and 0 < value <= 1, "a number above 0, up to 1")
BETWEEN = Rule(lambda value: _is_number(value) and 0 < value < 1, "a number between 0 and 1")
FROM_1 = Rule(lambda value: _is_number(value) and value >= 1, "1 or a number above it")
COUNT = Rule(lambda value: _is_whole(value) and value >= 1, "a whole number, 1 or more")
COUNT_FROM_0 = Rule(lambda value: _is_whole(value) and value >= 0, "a whole number, 0 or more")
FIELD_OF_VIEW = Rule(lambda value: _is_number(value) and 0 < value < 180, "degrees between 0 and 180")
TURN = Rule(lambda value: _is_number(value) and 0 < value <= 360, "degrees above 0, up to 360")
ELEVATION = Rule(lambda value: _is_number(value) and -90 <= value <= 90, "degrees from -90 to 90")


def check_values(cfg: Mapping) -> None:
    """ConfigError for the first key that no rule knows, or whose value it does not allow."""
    from pcdet_avp.config_keys import RULES

    for key, value, pattern in _leaves(cfg, "", ""):
        rule = RULES.get(pattern) or _of_section(RULES, pattern)
        if rule is None:
            raise ConfigError(f"configuration: unknown key {key}; {_near(pattern, RULES)}")
        if not rule.allows(value):
            raise ConfigError(f"configuration: {key}: expected {rule.expected}, found {value!r}")
        _refuse_endless(key, value)


def _leaves(value: Any, key: str, pattern: str) -> Iterator[tuple[str, Any, str]]:
    """Key, value and pattern (``*`` for the number of an item) of every value that is no section of its own."""
    from pcdet_avp.config_keys import LEAVES, is_foreign

    if isinstance(value, Mapping) and value and pattern not in LEAVES and not is_foreign(pattern, value):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}".lstrip("."), f"{pattern}.{name}".lstrip("."))
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{key}.{number}", f"{pattern}.*")
    else:
        yield key, value, pattern


def _of_section(rules: Mapping[str, Rule], pattern: str) -> Rule | None:
    """For a section that is null or empty, or of a class of the user's own."""
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
