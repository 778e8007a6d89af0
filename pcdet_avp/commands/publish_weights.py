"""``tools/publish_weights.py``: what others need of a finished run, without the optimiser's state."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from pcdet_avp.argument_types import Parser, path
from pcdet_avp.cli import run_tool
from pcdet_avp.engine.checkpoint import furthest_first, save, weights_hash
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.agreement import MEANING_KEY, meaning_in
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY, read_checkpoint

KEPT = ("model_state", "epoch", "it", "elapsed_s", "version", "versions", "config_name", "config_hash", "config")
WITH_BOXES = (*KEPT, THRESHOLDS_KEY)
WITHOUT_BOXES = ("CameraDepth",)  # networks that need no score thresholds


def main() -> None:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ckpt", type=path, required=True, help="checkpoint of a finished run, or its folder")
    parser.add_argument("--out", type=path, required=True, help="file to write, .pth or .safetensors")
    args = parser.parse_args()
    ckpt = furthest_of(args.ckpt) if args.ckpt.is_dir() else args.ckpt
    kept = published(read_checkpoint(ckpt), ckpt)
    save(args.out, kept)
    size = args.out.stat().st_size / 2**20
    print(f"wrote {args.out}: weights {weights_hash(kept['model_state'])}, {size:.1f} MB")


def published(content: dict[str, Any], ckpt: Path) -> dict[str, Any]:
    """What of a checkpoint's content others need, without paths of this machine.

    CheckpointError, which names ``ckpt``, where something of it is missing.
    """
    keys = KEPT if content.get("config", {}).get("MODEL", {}).get("NAME") in WITHOUT_BOXES else WITH_BOXES
    missing = [key for key in keys if key not in content]
    if missing:
        raise CheckpointError(
            f"{ckpt}: lacks {', '.join(missing)}; tools/train.py chooses score thresholds at the end of a run"
        )
    config = content["config"]
    data = {**config["DATA_CONFIG"], "DATA_PATH": Path(config["DATA_CONFIG"]["DATA_PATH"]).name}
    said = without_folders({"config": {**config, "DATA_CONFIG": data}, MEANING_KEY: meaning_in(content)})
    return {key: content[key] for key in keys} | said


def without_folders(value: Any) -> Any:
    """A copy in which every text that is a path of this machine is the name at its end.

    Such are absolute paths, of Windows too, and those that begin in a home folder or lead out of the working folder.
    """
    if isinstance(value, dict):
        return {key: without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_folders(item) for item in value]
    return _name_of(value) if isinstance(value, str) else value


def _name_of(text: str) -> str:
    for found in (PurePosixPath(text), PureWindowsPath(text)):
        if found.is_absolute() or text.startswith("~") or found.parts[:1] == ("..",):
            return found.name
    return text


def furthest_of(folder: Path) -> Path:
    """The checkpoint of a run's folder that was trained longest."""
    found = furthest_first(folder)
    if not found:
        raise CheckpointError(f"{folder}: no checkpoint there")
    return found[0]


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
