"""``manifest.json`` of an exported network: what its weights mean, what its graphs leave open, hashes of its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcdet_avp.deploy.network import Network
from pcdet_avp.errors import ExportError
from pcdet_avp.link.header import network_number

MANIFEST = "manifest.json"
FORMAT = 1  # raised whenever files or their inputs change their meaning
HALVES = ("roadside", "vehicle")
DESCRIBED, DIGEST = ("network", "meaning"), "described_sha256"


@dataclass(frozen=True, eq=False)
class Exported:
    """An exported network on disk. ``facts``: the manifest's other keys (precision, checkpoint, thresholds, ...)."""

    folder: Path
    network: Network
    meaning: Mapping[str, Any]
    files: Mapping[str, Mapping[str, Any]]  # "roadside/camera.onnx" -> sha256, bytes
    facts: Mapping[str, Any]

    @classmethod
    def read(cls, folder: Path) -> Exported:
        """What lies in a folder; ExportError where it is no exported network or one of another format."""
        path = Path(folder) / MANIFEST
        content = _json_object(path)
        found = content.get("format")
        if found != FORMAT:
            raise ExportError(f"{path}: format: expected {FORMAT}, found {found!r}; export the checkpoint again")
        try:
            network, digest = Network.from_json(content["network"]), content.get(DIGEST)
            if digest not in (None, described_sha256(content)):  # None: exported before there was one
                parts = " and ".join(DESCRIBED)
                raise ExportError(f"{path}: {parts}: not what was exported; export the checkpoint again")
            files = {str(name): {"sha256": str(about["sha256"])} | about for name, about in content["files"].items()}
            return cls(Path(folder), network, dict(content["meaning"]), files, content)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ExportError(f"{path}: damaged, or written by another version ({error})") from error

    @property
    def network_number(self) -> int:
        """That of the weights which were exported; 0 where the manifest does not name them."""
        found = self.facts.get("weights_hash")
        try:
            return 0 if found is None else network_number(found)
        except (TypeError, ValueError) as error:
            raise ExportError(f"{self.folder / MANIFEST}: weights_hash: expected 16 digits, found {found!r}") from error

    def graph(self, name: str) -> bytes:
        """The content of ``roadside/camera.onnx`` and the like; ExportError where it is not what was exported."""
        path = self.folder / name
        if name not in self.files:
            raise ExportError(f"{self.folder / MANIFEST}: files: expected {name}, found {', '.join(self.files)}")
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ExportError(f"{path}: cannot be read ({error.strerror})") from error
        expected, found = self.files[name]["sha256"], sha256(content)
        if found != expected:
            raise ExportError(f"{path}: damaged or replaced: SHA-256: expected {expected[:16]}, found {found[:16]}")
        return content


def sha256(content: bytes) -> str:
    """64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def described_sha256(content: Mapping[str, Any]) -> str:
    """Of what says how a graph's numbers are read: another order of classes swaps them."""
    return sha256(json.dumps({key: content[key] for key in DESCRIBED}, sort_keys=True).encode())


def _json_object(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        why = f"{error.strerror}; expected a folder that tools/export.py wrote"
        raise ExportError(f"{path}: cannot be read ({why})") from error
    except ValueError as error:
        raise ExportError(f"{path}: damaged: no JSON ({error})") from error
    if not isinstance(content, dict):
        raise ExportError(f"{path}: damaged: expected an object, found {type(content).__name__}")
    return content
