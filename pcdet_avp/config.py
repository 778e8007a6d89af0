"""Configuration: OpenPCDet's YAML schema, read into an ``EasyDict``; there is no global configuration.

``_BASE_CONFIG_: path`` in any mapping pulls in another file, relative to the file that names it, and so on
recursively; mappings merge key by key, everything else (lists too) is replaced. A file that is not there is looked
for among those that come with the package (``pcdet_avp.shipped``). A relative ``DATA_PATH`` is made absolute against
the file that holds it, against the working folder where that file lies in an installed package or the value comes
from ``--set``.
"""

from __future__ import annotations

import copy
import difflib
import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from easydict import EasyDict

from pcdet_avp import shipped
from pcdet_avp.config_scenes import OPTIONAL_KEYS, known_name, without_defaults
from pcdet_avp.errors import ConfigError
from pcdet_avp.yaml_loader import FiniteLoader

BASE_KEY = "_BASE_CONFIG_"
PATH_KEYS = ("DATA_PATH",)  # values that say where something lies, not what it is
# Keys of later versions, at the value that means what earlier ones did without them.
LATER_KEYS = {"ROADSIDE_UNIT": None, "SPLIT_BY": "scene", "MAX_BYTES": None, "CONSTANT_SIZE": False}


class _Loader(FiniteLoader):
    """Reads 1e-3 as a number, and refuses a key written twice."""

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value:
            key = key_node.value
            if isinstance(key, str) and key != "<<" and key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} occurs twice", key_node.start_mark)
            seen.add(key if isinstance(key, str) else id(key))
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def load_config(path: str | os.PathLike) -> EasyDict:
    """Read a YAML file with everything it builds on; ``shipped.find_config`` says which file."""
    return EasyDict(_load(shipped.find_config(path), ()))


def _load(path: Path, parents: tuple[Path, ...]) -> dict:
    path = Path(os.path.abspath(path))
    if path in parents:
        chain = " -> ".join(str(p) for p in (*parents[parents.index(path) :], path))
        raise ConfigError(f"{parents[-1]}: {BASE_KEY} runs in a circle: {chain}")
    content = _read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected a mapping at the top, found {_kind(content)}")
    return _expand(content, path, (*parents, path), "")


def _read_yaml(path: Path) -> Any:
    try:
        return yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read this configuration file ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text ({error})") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: broken YAML: nested too deeply") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else "unknown line"
        problem = getattr(error, "problem", None) or str(error)
        raise ConfigError(f"{path}: broken YAML in {line}: {problem}") from error


def _expand(content: dict, path: Path, chain: tuple[Path, ...], prefix: str) -> dict:
    """Replace every ``_BASE_CONFIG_`` inside ``content`` by the file's own content, overlaid by its siblings."""
    base: dict = {}
    if BASE_KEY in content:
        base = _load(_base_path(content[BASE_KEY], path, prefix), chain)
    own = {}
    for key, value in content.items():
        if key == BASE_KEY:
            continue
        if not isinstance(key, str):
            raise ConfigError(f"{path}: keys must be text, found {key!r} under {prefix or 'the top'}")
        key = known_name(key, prefix.split(".")[:-1])
        if key in own:
            raise ConfigError(f"{path}: {prefix}{key} is given twice, in capitals and in lower case")
        if isinstance(value, dict):
            value = _expand(value, path, chain, f"{prefix}{key}.")
        elif key in PATH_KEYS and isinstance(value, str):
            value = shipped.in_home(os.path.abspath(path.parent / _expanded(value)))
        own[key] = value
    return _merge(base, own, path, prefix)


def _expanded(path: str) -> str:
    """A path with ``~`` as the home folder; one that names an unknown user is an error."""
    expanded = os.path.expanduser(path)
    if not path.strip() or expanded.startswith("~"):
        raise ConfigError(f"{' or '.join(PATH_KEYS)} {path!r}: expected the path of a folder")
    return expanded


def _base_path(named: Any, path: Path, prefix: str) -> Path:
    if not isinstance(named, str):
        raise ConfigError(f"{path}: {prefix}{BASE_KEY} must be the path of a file, found {_kind(named)}")
    base = shipped.find(named, path.parent)
    if base is None or not base.is_file():
        raise ConfigError(f"{path}: {prefix}{BASE_KEY} names {named!r}, but {shipped.not_found(named, path.parent)}")
    return base


def _merge(base: dict, own: dict, path: Path, prefix: str) -> dict:
    merged = dict(base)
    for key, value in own.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            merged[key] = _merge(old, value, path, f"{prefix}{key}.")
        elif isinstance(old, dict) and value is not None:
            raise ConfigError(f"{path}: {prefix}{key}: expected a mapping as in the base file, found {_kind(value)}")
        else:
            merged[key] = value
    return merged


def apply_overrides(cfg: EasyDict, pairs: list[str]) -> EasyDict:
    """Set dotted keys in place, as from ``--set A.B 1 LIST.0.NAME x``, and return ``cfg``.

    Every key must exist, but for those that GENERATE may lack (``OPTIONAL_KEYS``). A value keeps the type of the one
    that it replaces, except that an integer may stand for a float and null may replace, or be replaced by, anything.
    """
    if len(pairs) % 2:
        raise ConfigError(f"--set needs pairs of key and value, found {len(pairs)} words: {' '.join(pairs)}")
    for key, text in zip(pairs[::2], pairs[1::2], strict=True):
        _override(cfg, key.split("."), key, text)
    return cfg


def _override(cfg: EasyDict, parts: list[str], key: str, text: str) -> None:
    holder: Any = cfg
    for depth, part in enumerate(parts[:-1]):
        holder = holder[_child(holder, part, key, parts[:depth])]
    if isinstance(holder, dict) and parts[-2:-1] == ["GENERATE"] and parts[-1] in OPTIONAL_KEYS:
        holder.setdefault(parts[-1], None)
    last = _child(holder, parts[-1], key, parts[:-1])
    value = _typed(holder[last], text, key)
    if last in PATH_KEYS and isinstance(value, str):
        value = os.path.abspath(_expanded(value))
    holder[last] = value


def _child(holder: Any, part: str, key: str, above: list[str]) -> str | int:
    """The key or index in ``holder`` that ``part`` means."""
    where = ".".join(above) or "the top level"
    if isinstance(holder, list):
        if part.isdecimal() and int(part) < len(holder):
            return int(part)
        raise ConfigError(f"--set {key}: {where} is a list of {len(holder)} items, {part!r} is not an index of it")
    if not isinstance(holder, dict):
        raise ConfigError(f"--set {key}: {where} is {_kind(holder)}, it has no key {part!r}")
    part = known_name(part, above)
    if part not in holder:
        raise ConfigError(f"--set {key}: {where} has no key {part!r}; {_near(part, holder)}")
    return part


def _typed(old: Any, text: str, key: str) -> Any:
    """Parse ``text`` as YAML and hold it against the type of the value that it replaces."""
    try:
        new = yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"--set {key}: {text!r} is not a YAML value") from error
    if isinstance(old, str) and new is not None and not isinstance(new, str):
        return text
    if type(old) is float and type(new) is int:
        return float(new)
    if isinstance(old, dict) and isinstance(new, dict):
        return EasyDict(_overlay(old, new, key))
    if old is not None and new is not None and _kind(old) != _kind(new):
        raise ConfigError(f"--set {key}: expected {_kind(old)} like the present {old!r}, found {_kind(new)} {text!r}")
    return EasyDict({"new": new}).new


def _overlay(old: dict, new: dict, key: str) -> dict:
    """``old`` with the entries of ``new``, each checked like an override of its own."""
    merged = copy.deepcopy(old)
    for name, value in new.items():
        name = _child(merged, name, f"{key}.{name}", key.split("."))
        merged[name] = _typed(merged[name], yaml.safe_dump(value, default_flow_style=True), f"{key}.{name}")
    return merged


def ignoring(cfg: EasyDict, keys: Iterable[str]) -> EasyDict:
    """``cfg`` whose network takes weights that differ in these keys (see ``models.weights.agreement``)."""
    if keys:
        cfg.MODEL["IGNORE_CONFIG"] = [*(cfg.MODEL.get("IGNORE_CONFIG") or []), *keys]
    return cfg


def require(cfg: Mapping, key: str, kinds: type | tuple[type, ...] | None = None) -> Any:
    """The value under a dotted key; a missing one, or one of another type, is a ConfigError that names it."""
    value: Any = cfg
    for part in key.split("."):
        if not isinstance(value, dict) or part not in value:
            near = _near(part, value) if isinstance(value, dict) else f"found {_kind(value)} above it"
            raise ConfigError(f"configuration: missing key {key}; {near}")
        value = value[part]
    if kinds is not None and (not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool)):
        names = " or ".join(k.__name__ for k in (kinds if isinstance(kinds, tuple) else (kinds,)))
        raise ConfigError(f"configuration: {key} must be {names}, found {value!r}")
    return value


def plain(value: Any) -> Any:
    """A configuration as plain mappings and lists, for YAML, JSON and checkpoints."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def config_hash(cfg: dict) -> str:
    """16 hexadecimal digits that change with any value, but not with key order or with where the data lie.

    Settings of generated scenes count where they differ from their defaults, whether or not they are written out;
    those of registration, and of the limit on a map's bytes, only where it is on.
    """
    text = json.dumps(_reduced(cfg), sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _reduced(value: Any, key: str = "") -> Any:
    if isinstance(value, dict):
        value = without_defaults(value) if key == "GENERATE" else value
        unset = {k for k, default in LATER_KEYS.items() if value.get(k, default) == default}
        unset |= {k for k in ("REGISTRATION",) if not (value.get(k) or {}).get("ENABLED")}
        return {k: _reduced(v, k) for k, v in value.items() if k not in PATH_KEYS and k not in unset}
    if isinstance(value, list | tuple):
        return [_reduced(v) for v in value]
    return value


def _near(part: str, holder: dict) -> str:
    close = difflib.get_close_matches(part, list(holder), n=5, cutoff=0.5)
    return f"near ones: {', '.join(close)}" if close else f"known: {', '.join(holder) or 'none'}"


def _kind(value: Any) -> str:
    names = {dict: "a mapping", list: "a list", tuple: "a list", str: "text", type(None): "nothing (null)"}
    names |= {bool: "a boolean", int: "an integer", float: "a number", EasyDict: "a mapping"}
    return names.get(type(value), type(value).__name__)
