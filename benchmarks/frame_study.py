"""What pose.py, delay.py and localisation.py share: a network, the frames of a split, the files that they write."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from easydict import EasyDict
from torch import nn

from pcdet_avp.bandwidth.parts import key_of
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.outputs import RunFolder, open_log
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.files import make_folder, write_json, write_text
from pcdet_avp.provenance import provenance

Rows = Sequence[dict]


@dataclass(frozen=True, eq=False)
class FrameStudy:
    """A split of a data set, and the network that runs on it; ``kind`` names the results' folder and files."""

    kind: str
    cfg: EasyDict
    args: argparse.Namespace
    out: Path
    ranks: distributed.Ranks
    dataset: Any
    model: nn.Module
    content: dict[str, Any]  # of the checkpoint
    weights: str  # their hash

    @classmethod
    def open(cls, kind: str, cfg: EasyDict, args: argparse.Namespace, device: str | None = "cpu") -> FrameStudy:
        """``args``: cfg, ckpt, split, out. ``device`` None: a GPU where there is one."""
        out = args.out or RunFolder.of(args.cfg).root / kind
        make_folder(out)
        logger, ranks = open_log(out, kind), distributed.start(device=device)
        dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split, logger=logger)
        model, content = load_network(cfg, args.ckpt, dataset, ranks, logger)
        weights = checkpoint.weights_hash(content["model_state"])
        return cls(kind, cfg, args, out, ranks, dataset, model, content, weights)

    @property
    def name(self) -> str:
        """Of the configuration."""
        return Path(self.args.cfg).stem

    def frames_folder(self, *conditions: Any) -> Path:
        """Where results of single frames lie; another one for other weights, data, settings or conditions."""
        return self.out / f"frames_{key_of(self.cfg, self.dataset.root_path, self.weights, *conditions)}"

    def title(self, about: str, frames: int) -> str:
        """The first line of a page."""
        return f"{about}, {self.name}, {self.args.ckpt.name}, {frames} frames of {self.args.split}"

    def write(
        self,
        title: str,
        rows: Rows,
        table: Callable[[Rows, str], str],
        plot: Callable[[Rows, str, Path], None],
        frames: int,
        seed: int = 0,
        **meta: Any,
    ) -> None:
        """JSON, page and plot of the rows; the page is printed, too."""
        about = {"checkpoint": self.args.ckpt.name, "frames": frames, **meta}
        about = provenance(self.cfg, self.name, seed=seed, weights_hash=self.weights) | about
        text = table(rows, title)
        plot(rows, self.name, self.out / f"{self.kind}.png")
        write_json(self.out / f"{self.kind}.json", {"meta": about, "rows": rows})
        write_text(self.out / f"{self.kind}.md", text + "\n")
        print(f"\n{text}\n\nwritten to {self.out}")
