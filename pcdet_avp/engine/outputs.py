"""Where a run's files lie: output/<group>/<tag>/<extra_tag>/ below the working directory, as in OpenPCDet."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from pcdet_avp.config import plain
from pcdet_avp.errors import ConfigError

CONFIG_FOLDER = "cfgs"


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run and what lies in it."""

    root: Path

    @classmethod
    def of(cls, cfg_path: str | os.PathLike, extra_tag: str = "default", base: Path = Path("output")) -> RunFolder:
        """``cfgs/avp/cp_small.yaml`` -> ``output/avp/cp_small/default``, wherever the ``cfgs`` folder is."""
        path = Path(os.path.abspath(cfg_path))
        parents = path.parent.parts
        if CONFIG_FOLDER in parents:
            group = parents[len(parents) - parents[::-1].index(CONFIG_FOLDER) :]
        else:
            group = parents[-1:]
        return cls(base.joinpath(*group, path.stem, extra_tag))

    @property
    def checkpoints(self) -> Path:
        return self.root / "ckpt"

    @property
    def tensorboard(self) -> Path:
        return self.root / "tensorboard"

    @property
    def evaluation(self) -> Path:
        return self.root / "eval"

    def create(self) -> RunFolder:
        """Make the folders; ConfigError where that is not possible."""
        for folder in (self.root, self.checkpoints, self.evaluation):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise ConfigError(f"{folder}: cannot make this folder ({error.strerror})") from error
        return self

    def write_config(self, cfg: Mapping, name: str) -> None:
        """The configuration with its bases and overrides resolved."""
        write_text(self.root / f"{name}.yaml", yaml.safe_dump(plain(cfg), sort_keys=False))


def write_text(path: Path, text: str) -> None:
    """Write a whole text file, or none."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file, or none."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        aside.write_bytes(content)
        os.replace(aside, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error


def write_json(path: Path, content: Any) -> None:
    """Write a whole JSON file; NaN is a bug here."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def open_log(folder: Path, kind: str, first: bool = True) -> logging.Logger:
    """A logger to ``folder/<kind>_<time>.log`` and, around the progress bar, to the terminal; only rank 0 speaks."""
    logger = logging.Logger(f"pcdet_avp.{kind}", logging.INFO if first else logging.ERROR)
    terminal = _Terminal()
    terminal.setFormatter(logging.Formatter("%(message)s"))
    logger.addHandler(terminal)
    if first:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        file = logging.FileHandler(folder / f"{kind}_{stamp}.log", encoding="utf-8", delay=True)
        file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        logger.addHandler(file)
    return logger


class _Terminal(logging.Handler):
    """Writes above a progress bar, if one is shown. Records with ``quiet=True`` go to the file only."""

    def emit(self, record: logging.LogRecord) -> None:
        if not getattr(record, "quiet", False):
            tqdm.write(self.format(record), file=sys.stderr)
