"""ASN.1 files from a folder: those that a module needs, and the bounds that asn1tools would lose."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pcdet_avp.errors import ConfigError

# ETSI's files are not all UTF-8 (an accent in a comment); every byte is a character of Latin-1.
ENCODING = "latin-1"
_COMMENT = re.compile(r"/\*.*?\*/|--[^\n]*", re.DOTALL)
_MODULE = re.compile(r"([A-Z][\w-]*)\s*(?:\{[^}]*\})?\s*DEFINITIONS\b")
_IMPORT = re.compile(r"\bFROM\s+([A-Z][\w-]*)")


def files_needed(folder: Path, module: str) -> list[Path]:
    """The files of a folder, at any depth, with a module and all that it imports.

    Raises ConfigError, naming the module, where there is none of it or more than one.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: expected a folder with ASN.1 files, found none")
    texts = {file: _COMMENT.sub("", file.read_text(ENCODING)) for file in sorted(folder.rglob("*.asn*"))}
    found: dict[str, list[Path]] = {}
    for file, text in texts.items():
        for name in _MODULE.findall(text):
            found.setdefault(name, []).append(file)
    needed: dict[str, Path] = {}
    wanted = [module]
    while wanted:
        name = wanted.pop()
        if name not in needed:
            needed[name] = _only(folder, name, found.get(name, []))
            wanted += _IMPORT.findall(texts[needed[name]])
    return sorted(set(needed.values()))


def _only(folder: Path, module: str, files: list[Path]) -> Path:
    if len(files) != 1:
        found = ", ".join(str(file.relative_to(folder)) for file in files) or "none"
        raise ConfigError(f"{folder}: expected one ASN.1 file (*.asn) with module {module}, found {found}")
    return files[0]


def with_whole_bounds(modules: Mapping[str, Any]) -> Mapping[str, Any]:
    """What ``asn1tools.parse_files`` returns, with every bound of several parts widened to one, from least to greatest.

    Of ``(unknown | passengerCar..tram | agricultural)`` asn1tools 0.169.0 keeps the first part alone: the value would
    take no bit and be written over what stands before it. X.691 counts from the least to the greatest of all parts.
    """
    types = {name: found for module in modules.values() for name, found in module["types"].items()}
    for found in _described(dict(modules)):
        parts = found.get("restricted-to") or []
        root = parts[: parts.index(None)] if None in parts else parts  # None: what follows is an extension
        if len(root) > 1:
            ends = [
                _number(end, found, types) for part in root for end in (part if isinstance(part, tuple) else (part,))
            ]
            numbers = [end for end in ends if end is not None]
            if len(numbers) == len(ends):
                found["restricted-to"] = [(min(numbers), max(numbers)), *parts[len(root) :]]
    return modules


def _described(node: Any) -> Iterator[dict]:
    """Every type of the modules, at any depth."""
    if isinstance(node, dict):
        yield node
    if isinstance(node, dict | list):
        for below in node.values() if isinstance(node, dict) else node:
            yield from _described(below)


def _number(end: Any, found: Mapping, types: Mapping[str, Mapping]) -> int | None:
    """A bound as a number: a type's named numbers are looked up; None where it is not one (a string, MIN, MAX)."""
    kind: Mapping | None = found
    while isinstance(end, str) and kind is not None:
        end = kind.get("named-numbers", {}).get(end, end)
        kind = types.get(kind["type"])
    return end if isinstance(end, int) else None
