"""Folders of a run's files: output/<group>/<tag>/<extra_tag>/ below the working directory, as in OpenPCDet."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import yaml
from tqdm import tqdm

from pcdet_avp import shipped
from pcdet_avp.config import plain
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import make_folder, write_text

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
        """Make the folders; OutputError if that is not possible."""
        for folder in (self.root, self.checkpoints, self.evaluation):
            make_folder(folder)
        return self

    def write_config(self, cfg: Mapping, name: str) -> None:
        """The configuration with its bases and overrides resolved."""
        write_text(self.root / f"{name}.yaml", yaml.safe_dump(plain(cfg), sort_keys=False))


def choose_checkpoint(
    given: str | os.PathLike | None, cfg: str | os.PathLike, folder: Path, tell: Callable[[str], None]
) -> Path:
    """The checkpoint that a tool works with: the given one, the furthest in a run's ``folder``, or the package's own.

    Without a given one, ``tell`` hears which was taken. The package's weights serve the configuration that they were
    trained with, ``cfg``, and no other. ConfigError where there is none at all.
    """
    if given is not None:
        return shipped.find_checkpoint(given)
    from pcdet_avp.engine.checkpoint import furthest_first  # imports torch

    if own := furthest_first(folder):
        tell(f"no --ckpt: taking the checkpoint of this run that was trained longest, {own[0]}")
        return own[0]
    weights = shipped.weights_of(shipped.find_config(cfg))
    if weights is None:
        raise ConfigError(f"{folder}: no checkpoint there; name one with --ckpt, or train with tools/train.py")
    tell(f"no --ckpt, and no checkpoint in {folder}: taking the weights that come with the package, {weights}")
    return weights


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
