"""Reading JSON that others may have written: every wrong or missing value is an error that names file and field."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.errors import GeometryError, RecordError
from pcdet_avp.structures.pose import Pose

KINDS = {str: "text", int: "a whole number", float: "a number", list: "a list", dict: "an object", bool: "a boolean"}


class Field:
    """A value inside a JSON file that knows where it stands."""

    __slots__ = ("file", "name", "value")

    def __init__(self, value: Any, file: Path, name: str = "") -> None:
        self.value, self.file, self.name = value, file, name

    @classmethod
    def load(cls, file: Path) -> Field:
        """The top-level object of a JSON file."""
        try:
            value = json.loads(file.read_text(encoding="utf-8-sig"))  # some writers begin with a byte order mark
        except FileNotFoundError as error:
            raise RecordError(f"{file}: no such file") from error
        except OSError as error:
            raise RecordError(f"{file}: cannot be read ({error.strerror})") from error
        except (ValueError, RecursionError) as error:
            raise RecordError(f"{file}: damaged or cut short, not JSON ({error})") from error
        top = cls(value, file)
        top.of(dict)
        return top

    def error(self, problem: str) -> RecordError:
        return RecordError(f"{self.file}: {self.name or 'top level'}: {problem}")

    def __getitem__(self, key: str) -> Field:
        """A field that must be there."""
        if key not in self.of(dict):
            known = ", ".join(map(str, self.value)) or "none"
            raise RecordError(f"{self.file}: {self._join(key)}: missing; fields here: {known}")
        return Field(self.value[key], self.file, self._join(key))

    def get(self, key: str, default: Any = None) -> Field:
        """A field that may be absent or null and then holds ``default``."""
        value = self.of(dict).get(key)
        return Field(default if value is None else value, self.file, self._join(key))

    def __iter__(self) -> Iterator[Field]:
        for i, value in enumerate(self.of(list)):
            yield Field(value, self.file, f"{self.name}[{i}]")

    def __bool__(self) -> bool:
        """Whether the field holds anything at all."""
        return self.value is not None

    def of(self, kind: type) -> Any:
        """The value, if it is of this JSON type; a boolean is no number, a whole number is one."""
        kinds = (int, float) if kind is float else kind
        if not isinstance(self.value, kinds) or (isinstance(self.value, bool) and kind is not bool):
            raise self.error(f"expected {KINDS[kind]}, found {str(self.value)[:60]!r}")
        return self.value

    def number(self) -> float:
        """A finite number."""
        try:
            value = float(self.of(float))
        except OverflowError:  # a whole number of hundreds of digits
            value = math.inf
        if not math.isfinite(value):
            raise self.error(f"expected a finite number, found {value}")
        return value

    def numbers(self, *shape: int) -> np.ndarray:
        """Finite numbers of this shape, float64."""
        try:
            array = np.array(self.value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise self.error(f"expected numbers of shape {shape}, found {str(self.value)[:60]}") from error
        if array.shape != shape:
            raise self.error(f"expected numbers of shape {shape}, found shape {array.shape}")
        if not np.isfinite(array).all():
            raise self.error("holds NaN or infinite values")
        return array

    def pose(self) -> Pose:
        """A rigid 4 x 4 matrix."""
        matrix = self.numbers(4, 4)
        return self.build(Pose, matrix)

    def build(self, make, *args):
        """``make(*args)``, with an error of the structure itself placed at this field."""
        try:
            return make(*args)
        except GeometryError as error:
            raise self.error(str(error)) from error

    def _join(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key


def write_record_json(file: Path, content: dict) -> int:
    """Write compactly, keys in the order given; refuse values that JSON has no words for. Returns the size in bytes."""
    try:
        data = (json.dumps(content, separators=(",", ":"), allow_nan=False) + "\n").encode()
    except (TypeError, ValueError) as error:
        raise RecordError(f"{file}: cannot be written as JSON: {error}") from error
    file.write_bytes(data)
    return len(data)
