"""Kinds of values of a configuration: what each accepts, and how it is told what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any


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


def one_of(*words: str) -> Rule:
    """One of these words."""
    return Rule(lambda value: value in words, " or ".join(words))


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


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
FACTORS = Rule(
    lambda value: isinstance(value, Mapping) and all(_is_number(factor) and factor >= 0 for factor in value.values()),
    "a mapping from names to 0 or a number above it",
    optional=True,
)
BETWEEN = Rule(lambda value: _is_number(value) and 0 < value < 1, "a number between 0 and 1")
FROM_1 = Rule(lambda value: _is_number(value) and value >= 1, "1 or a number above it")
COUNT = Rule(lambda value: _is_whole(value) and value >= 1, "a whole number, 1 or more")
COUNT_FROM_0 = Rule(lambda value: _is_whole(value) and value >= 0, "a whole number, 0 or more")
FIELD_OF_VIEW = Rule(lambda value: _is_number(value) and 5 <= value < 180, "degrees from 5 to below 180")
TURN = Rule(lambda value: _is_number(value) and 0 < value <= 360, "degrees above 0, up to 360")
ELEVATION = Rule(lambda value: _is_number(value) and -90 <= value <= 90, "degrees from -90 to 90")
