"""What each part behind the encoders is worth: the encoders shared and frozen, everything else begun anew alike.

    python benchmarks/ablations.py --cfg cfgs/avp/cp_small.yaml --ckpt F [--rows default,max_fusion] [--seeds 0,1]
        [--epochs 2] [--use_amp] [--split test] [--combos C+C,CL+C,CL+CL] [--set DATA_CONFIG.DATA_PATH D] [--out DIR]

Every row, ``default`` included, takes the encoders of the weights F and trains fuser, codec, backbone and head from
fresh weights of the row's seed, for the same number of iterations on the same frames in the same order; a row differs
from ``default`` in what ``ROWS`` says and in nothing else. Every map goes through encoded bytes. The table has strict
AP of each seed and the paired difference to ``default`` of the same seed, with its 95 % interval over scenes.

``early_fusion`` merges the roadside's cloud into the vehicle's before its encoder, which sees other clouds than it was
trained with and is therefore trained, too; no bytes count, and the roadside sends nothing else: a bound, not a method.
Without a LiDAR on both sides it is the vehicle alone.
Boxes sent instead of maps (late fusion) need no training: see tools/bandwidth_report.py and
docs/results/cp_small_first_late_fusion.md.

Resumable: rows that are done are read again, a row that was interrupted goes on; rows and seeds may be added, but the
folder belongs to one configuration, data set, F, split, list of combinations, number of epochs and precision
(asked.json).
Writes ablations.json, ablations.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.config import config_hash
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.manifest import manifest_hash
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.outputs import RunFolder, open_log
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.engine.testing.run import run_test
from pcdet_avp.engine.training.run import TrainOptions, run_training
from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation import bootstrap_gain, evaluate
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.detections_file import read_detections
from pcdet_avp.files import make_folder, write_json, write_text
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.provenance import provenance
from pcdet_avp.registry import DATASETS
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet

DEFAULT = "default"
FROZEN = {"encoders": 0.0}
EARLY = {"DATA_CONFIG.DATASET": "MergedClouds", "OPTIMIZATION.LR_FACTORS": {**FROZEN, "encoders.ego_lidar": 1.0}}
ROWS: dict[str, dict[str, object]] = {  # what a row changes, by dotted key
    DEFAULT: {},
    "spatial_ada_fusion": {"MODEL.FUSER.NAME": "SpatialAdaFusion"},
    "channel_ada_fusion": {"MODEL.FUSER.NAME": "ChannelAdaFusion"},
    "average_fusion": {"MODEL.FUSER.NAME": "AverageFusion"},
    "max_fusion": {"MODEL.FUSER.NAME": "MaxFusion"},
    "no_compression": {"MODEL.COMPRESSION": {"NAME": "NoCompression"}},
    "no_attention": {
        "MODEL.CAMERA_ENCODER.ATTENTION": None,
        "MODEL.LIDAR_ENCODER.ATTENTION": None,
        "MODEL.IGNORE_CONFIG": ["MODEL.CAMERA_ENCODER.ATTENTION", "MODEL.LIDAR_ENCODER.ATTENTION"],
    },
    "one_combination": {"OPTIMIZATION.SENSOR_SETS": ["CL+CL"]},  # rather than one drawn for every iteration
    "early_fusion": EARLY,
}


class MergedClouds(AvpDataset):
    """The vehicle's cloud, if any, with the roadside's in it, moved by the true pose; the roadside sends nothing."""

    def read(self, index: int, sensor_set: SensorSet) -> Frame:
        frame = super().read(index, sensor_set)
        ego = frame.ego
        if frame.infra.points is not None and ego.points is not None:
            moved = frame.infra.points.copy()
            moved[:, :3] = frame.ego_from_infra.apply(moved[:, :3])
            ego = replace(ego, points=np.concatenate([ego.points, moved.astype(ego.points.dtype)]), scan=None)
        return replace(frame, ego=ego, infra=replace(frame.infra, image=None, depth=None, points=None, scan=None))


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Ablations behind shared and frozen encoders.", weights=True)
    parser.add_argument("--ckpt", type=Path, required=True, help="whose encoders are used")
    parser.add_argument("--rows", default=",".join(ROWS), help="names between commas; default is always run")
    parser.add_argument("--seeds", default="0,1")
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--use_amp", action="store_true", help="train in mixed precision, on a CPU in bf16")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--combos", default="C+C,CL+C,CL+CL")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    args.rows = [DEFAULT, *(name for name in args.rows.split(",") if name != DEFAULT)]
    if unknown := [name for name in args.rows if name not in ROWS]:
        raise ConfigError(f"--rows: unknown {', '.join(unknown)}; known: {', '.join(ROWS)}")
    try:
        args.seeds = [int(seed) for seed in args.seeds.split(",")]
    except ValueError:
        raise ConfigError(f"--seeds: expected whole numbers between commas, found {args.seeds!r}") from None
    args.combos = parse_combos(args.combos)
    return args


def changed(cfg: Mapping, row: str, epochs: int) -> Mapping:
    """The configuration of a row."""
    own = deepcopy(cfg)
    own.OPTIMIZATION.LR_FACTORS = dict(FROZEN)
    own.OPTIMIZATION.NUM_EPOCHS = epochs
    for key, value in ROWS[row].items():
        *above, last = key.split(".")
        holder = own
        for part in above:
            holder = holder[part]
        holder[last] = deepcopy(value)
    return own


def claim(folder: Path, asked: Mapping[str, object]) -> None:
    """Note what the rows of a folder follow from; ConfigError where it holds those of something else."""
    file = folder / "asked.json"
    if file.exists():
        held = json.loads(file.read_text(encoding="utf-8"))
        for key, value in asked.items():
            if held.get(key) != value:
                raise ConfigError(
                    f"{file}: {key}: holds rows of {held.get(key)!r}, this run asks for {value!r}; choose another --out"
                )
    write_json(file, asked)


def asked_of(cfg: Mapping, args: argparse.Namespace) -> dict[str, object]:
    """All that every row follows from, beside its name and seed."""
    weights = checkpoint.weights_hash(read_checkpoint(args.ckpt)["model_state"])
    data = manifest_hash(cfg.DATA_CONFIG.DATA_PATH)
    asked = {"config_hash": config_hash(cfg), "data": data, "weights": weights, "epochs": args.epochs}
    return asked | {"use_amp": args.use_amp, "split": args.split, "combos": args.combos}


def encoders_of(ckpt: Path, out: Path) -> Path:
    """A file with the encoders' weights alone, and with what they mean."""
    content = read_checkpoint(ckpt)
    state = {key: value for key, value in content["model_state"].items() if key.startswith("encoders.")}
    kept = {key: content[key] for key in ("version", "config", "config_name", "meaning") if key in content}
    checkpoint.save(out / "encoders.pth", {**kept, "model_state": state})
    return out / "encoders.pth"


def run_row(cfg: Mapping, name: str, seed: int, args: argparse.Namespace, start: Path, ranks, logger) -> dict:
    """Train and test a row with one seed, or read what it gave: combination -> detections."""
    folder, own = RunFolder(args.out / f"{name}_{seed}").create(), changed(cfg, name, args.epochs)
    if not (folder.root / "result.json").exists():
        logger.info(f"row {name}, seed {seed}")
        options = TrainOptions(
            workers=0, seed=seed, use_amp=args.use_amp, pretrained_model=(start,), max_ckpt_save_num=1
        )
        last = run_training(own, args.name, folder, options, ranks, logger)
        wire, combos = name not in ("no_compression", "early_fusion"), args.combos
        run_test(own, args.name, last, combos, ranks, logger, split=args.split, wire=wire).write(folder.root)
    return {combo: read_detections(folder.root / "detections" / f"{combo}.npz") for combo in args.combos}


def rows_of(found: Mapping[tuple[str, int], dict], dataset, args: argparse.Namespace) -> list[dict]:
    """A dictionary per row, seed, combination and class: strict AP, and the paired difference to the default row."""
    truths, regions, rows = dataset.ground_truths(), dataset.regions(), []
    for (name, seed), detections in found.items():
        for combo in args.combos:
            before, after = found[DEFAULT, seed][combo], detections[combo]
            ap = evaluate(truths, after, regions, dataset.class_names)[1]
            for label in dataset.class_names:
                how = {"name": label, "min_overlap": STRICT_IOU[label], "region": regions[0]}
                gain = bootstrap_gain(truths, before, after, **how, rng=np.random.default_rng(0))
                numbers = {"difference": gain.points, "low": gain.low, "high": gain.high}
                about = {"row": name, "seed": seed, "combo": combo, "class": label}
                rows.append(about | {"ap": ap[f"{label}_overall_{STRICT_IOU[label]:g}"]} | numbers)
    return rows


def table(rows: Sequence[dict], args: argparse.Namespace, class_names: Sequence[str]) -> str:
    """Markdown: a line per row, a column per combination and class, the seeds in turn."""
    columns = [(combo, label) for combo in args.combos for label in class_names]
    header = ["", *(f"{combo} {label}" for combo, label in columns)]
    body = []
    for name in args.rows:
        cells = []
        for combo, label in columns:
            mine = [r for r in rows if (r["row"], r["combo"], r["class"]) == (name, combo, label)]
            cells.append("; ".join(cell(r) for r in mine))
        body.append([name, *cells])
    return "\n".join(markdown_table(header, body))


def cell(row: Mapping) -> str:
    text = f"{row['ap']:.1f}"
    if row["row"] == DEFAULT:
        return text
    return f"{text} ({row['difference']:+.1f} [{row['low']:+.1f}, {row['high']:+.1f}])"


def main() -> None:
    args, started = parse_arguments(), time.time()
    cfg, ranks = load_arguments_config(args), distributed.start(device="cpu")
    args.name, args.out = Path(args.cfg).stem, args.out or RunFolder.of(args.cfg).root / "ablations"
    DATASETS.register("MergedClouds")(MergedClouds)
    make_folder(args.out)
    claim(args.out, asked_of(cfg, args))
    logger = open_log(args.out, "ablations")
    start = encoders_of(args.ckpt, args.out)
    found = {}
    for seed in args.seeds:
        for name in args.rows:
            found[name, seed] = run_row(cfg, name, seed, args, start, ranks, logger)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split)
    rows = rows_of(found, dataset, args)
    meta = provenance(cfg, args.name, seed=args.seeds[0], started=started)
    meta |= {"encoders": args.ckpt.name, "epochs": args.epochs, "use_amp": args.use_amp}
    meta |= {"seeds": args.seeds, "split": args.split}
    write_json(args.out / "ablations.json", {"meta": meta, "rows": rows})
    text = table(rows, args, dataset.class_names)
    write_text(args.out / "ablations.md", text + "\n")
    print(f"\n{text}\n\nwritten to {args.out}")


if __name__ == "__main__":
    run_tool(main)
