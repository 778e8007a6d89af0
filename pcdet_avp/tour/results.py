"""The results of a tour that has got so far, read once for tables and summary."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation.average_precision import STRICT_IOU

GAIN = re.compile(r"^- (?P<combo>\S+), (?P<name>\w+) \S+: (?P<gain>.*?)(?: over \d+ scenes)?$", re.MULTILINE)


@dataclass(frozen=True)
class Benchmark:
    """meta: as in the JSON file. rows: combination -> row of the first region. gains: ``+10.5 [+8.1, +13.8]`` by
    (combination, class)."""

    meta: Mapping[str, Any]
    region: str
    rows: Mapping[str, Mapping[str, Any]]
    gains: Mapping[tuple[str, str], str]

    @classmethod
    def read(cls, json_file: Path, table_file: Path) -> Benchmark:
        """The results that ``tools/test.py`` wrote; ConfigError where a file is missing or is none of its."""
        content = read_json(json_file)
        try:
            region = content["rows"][0]["region"]
            rows = {row["combo"]: row for row in content["rows"] if row["region"] == region}
            meta = content["meta"]
        except (KeyError, IndexError, TypeError) as error:
            raise ConfigError(f"{json_file}: not the result of a test ({error!r})") from error
        found = GAIN.finditer(read_text(table_file))
        return cls(meta, region, rows, {(match["combo"], match["name"]): match["gain"] for match in found})

    def ap(self, combo: str, name: str) -> float | None:
        """Overall AP (%) at the strict IoU; None where no object had to be found."""
        return self.rows[combo][name]["overall"][f"{STRICT_IOU[name]:g}"]


def read_json(file: Path) -> Any:
    """ConfigError where it cannot be read."""
    try:
        return json.loads(read_text(file))
    except ValueError as error:
        raise ConfigError(f"{file}: not JSON ({error})") from error


def read_text(file: Path) -> str:
    """ConfigError where it cannot be read."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read ({error})") from error


def source_of(meta: Mapping[str, Any], **more: Any) -> str:
    """Configuration, seed, commit and command of a result, as markdown; ``more``: further names and values."""
    facts = {"configuration": meta.get("config"), **more, "seed": meta.get("seed")}
    words = [f"{name.replace('_', ' ')} {value}" for name, value in facts.items() if value is not None]
    if meta.get("git_commit"):
        words.append(f"commit {short_commit(meta['git_commit'])}")
    return f"Source: {', '.join(words)}; `{meta['command']}`"


def short_commit(commit: str) -> str:
    """Twelve digits, and whether files differed."""
    name, plus, changed = commit.partition("+")
    return name[:12] + plus + changed
