"""A YAML file as plain values, with the line on which each of them stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from pcdet_avp.errors import ConfigError
from pcdet_avp.yaml_loader import FiniteLoader

Where = tuple[str | int, ...]  # keys and numbers that lead to a value


class MarkedYaml:
    """``value``: what the file holds. ``line(where)``: the line (from 1) of the value there, or of what is above it."""

    def __init__(self, file: Path) -> None:
        self.file, self._lines = file, {}
        try:
            node = yaml.compose(file.read_text(encoding="utf-8"), Loader=FiniteLoader)
        except OSError as error:
            raise ConfigError(f"{file}: cannot be read ({error.strerror})") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"{file}: is not UTF-8 text ({error.reason} at byte {error.start})") from error
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            raise self.error(mark.line + 1 if mark else 1, getattr(error, "problem", None) or str(error)) from error
        except RecursionError as error:
            raise self.error(1, "nested too deeply") from error
        if node is None:
            raise self.error(1, "expected a plan, found an empty file")
        self.value = self._plain(node, ())

    def line(self, where: Where) -> int:
        while where and where not in self._lines:
            where = where[:-1]
        return self._lines.get(where, 1)

    def error(self, line: int, message: str) -> ConfigError:
        return ConfigError(f"{self.file}: line {line}: {message}")

    def _plain(self, node: yaml.Node, where: Where) -> Any:
        self._lines.setdefault(where, node.start_mark.line + 1)
        if isinstance(node, yaml.CollectionNode):
            return self._collection(node, where)
        try:
            return yaml.SafeLoader("").construct_object(node)
        except (yaml.YAMLError, ValueError) as error:
            raise self.error(node.start_mark.line + 1, f"{text(where)}: {error}") from error

    def _collection(self, node: yaml.CollectionNode, where: Where) -> Any:
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, where)
        return [self._plain(item, (*where, k)) for k, item in enumerate(node.value)]

    def _mapping(self, node: yaml.MappingNode, where: Where) -> dict[str, Any]:
        plain: dict[str, Any] = {}
        for key, item in node.value:
            line, name = key.start_mark.line + 1, str(key.value)
            if name in plain:
                raise self.error(line, f"{text((*where, name))}: is given twice")
            self._lines[(*where, name)] = line
            plain[name] = self._plain(item, (*where, name))
        return plain


def text(where: Where) -> str:
    """``floors[0].roads[1].lanes``."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in where).lstrip(".") or "plan"
