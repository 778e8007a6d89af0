"""What one result has over another on the same frames: paired differences of AP, with intervals over scenes.

    python tools/test.py --cfg C --ckpt BEFORE ...       # each prints the folder of its result
    python tools/test.py --cfg C --ckpt AFTER ...
    python benchmarks/paired.py --cfg C --before DIR --after DIR [--set DATA_CONFIG.DATA_PATH D]

Of every sensor combination that both folders hold: points of overall AP at the strict IoU in the first region (the
camera's view) that ``--after`` has more than ``--before``, and the 95 % bootstrap interval. The APs themselves stand in
each folder's table.md. C tells where the data lie; both results must be of one split.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation import bootstrap_gain
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.detections_file import read_detections
from pcdet_avp.files import flat_name
from pcdet_avp.structures.sensor_set import SENSOR_SETS


def read_meta(folder: Path) -> dict:
    """What tools/test.py says of the result in a folder."""
    try:
        return json.loads((folder / "result.json").read_text())["meta"]
    except (OSError, ValueError, KeyError) as error:
        raise EvaluationError(f"{folder}: not a result of tools/test.py ({error})") from error


def main() -> None:
    parser = config_parser("Two results on the same frames, paired.")
    for name in ("--before", "--after"):
        parser.add_argument(name, type=Path, required=True, metavar="DIR", help="folder with result.json")
    args = parser.parse_args()
    cfg, folders = load_arguments_config(args), (args.before, args.after)
    (split, by), *others = [(meta["split"], meta.get("split_by", "scene")) for meta in map(read_meta, folders)]
    if others != [(split, by)]:
        raise EvaluationError(f"--after: expected a result of split {split} by {by}, found {' by '.join(others[0])}")
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=split)
    truths, region, rows = dataset.ground_truths(), dataset.regions()[0], []
    for combo in SENSOR_SETS:
        files = [folder / "detections" / f"{flat_name(combo)}.npz" for folder in folders]
        if not all(file.exists() for file in files):
            continue
        results = [read_detections(file) for file in files]
        gains = [
            bootstrap_gain(
                truths, *results, name=name, min_overlap=STRICT_IOU[name], region=region, rng=np.random.default_rng(0)
            )
            for name in dataset.class_names
        ]
        rows.append([combo, *map(str, gains)])
    print("\n".join(markdown_table(["sensors", *dataset.class_names], rows)))


if __name__ == "__main__":
    run_tool(main)
