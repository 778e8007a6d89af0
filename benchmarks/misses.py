"""What is missed and why, from the detections that tools/test.py has left; with a picture of each kind of miss.

    python tools/test.py --cfg cfgs/avp/cp_small.yaml
    python benchmarks/misses.py --cfg cfgs/avp/cp_small.yaml \
        --result output/avp/cp_small/default/eval/cp_small/test/default [--combos C+none,C+C] [--pictures_of C+none]

Objects in the benchmark's first region, at the strict IoU and the score above which the car acts (0.3 for weights that
hold none). Kinds as in ``pcdet_avp/evaluation/error_kinds.py``; a sensor sees an object that fills 30 of its pixels
or returns 5 of its points. Runs no network. Writes misses.json, misses.md, misses.png and, for each kind of miss, the
frame that has most of it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from tqdm import tqdm

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.engine.testing.pictures import MIN_SCORE, above_scores
from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.detections_file import read_detections
from pcdet_avp.evaluation.error_kinds import FALSE_KINDS, OBJECT_KINDS, false_kinds, object_kinds
from pcdet_avp.evaluation.inputs import Detections, check_aligned
from pcdet_avp.evaluation.matching import ClassPairs, pair_up
from pcdet_avp.files import flat_name, make_folder, write_json, write_text
from pcdet_avp.structures.ego import centre_in_ego
from pcdet_avp.structures.frame import DIFFICULTIES, Labels
from pcdet_avp.structures.sensor_set import SOURCES, SensorSet
from pcdet_avp.visualization.frame_choice import seen_by_source
from pcdet_avp.visualization.misses import KIND_INKS, miss_picture
from pcdet_avp.visualization.video import write_picture

EDGES_M = (0.0, 10.0, 20.0, 30.0, 47.0)
MISSES = OBJECT_KINDS[1:4]  # what a better network could find
HARDEST = len(DIFFICULTIES) - 1


@dataclass(frozen=True, eq=False)
class Judged:
    """One class and combination: kinds of the T objects and K false detections, distance (T,) m, frame (T,) index."""

    combo: str
    name: str
    kinds: np.ndarray
    false: np.ndarray
    distance_m: np.ndarray
    frame: np.ndarray


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("What is missed, and why.")
    parser.add_argument("--result", type=Path, nargs="+", required=True, metavar="DIR", help="folders with result.json")
    parser.add_argument("--combos", default="all", help="all, or names between commas: C+none,C+CL")
    parser.add_argument("--pictures_of", metavar="COMBO", help="a picture of each kind of miss (default: the first)")
    parser.add_argument("--out", type=Path, help="default: misses in the first of the folders")
    return parser.parse_args()


def read_results(folders: Sequence[Path], combos: Sequence[str]) -> tuple[dict, dict[str, list[Detections]]]:
    """What the results have in common, and the detections of each combination."""
    metas, found = [], {}
    for folder in folders:
        file = folder / "result.json"
        if not file.is_file():
            raise EvaluationError(f"--result {folder}: expected a folder of tools/test.py, found no result.json")
        metas.append(json.loads(file.read_text())["meta"])
        files = {file.stem: file for file in (folder / "detections").glob("*.npz")}
        found |= {combo: read_detections(files[combo]) for combo in combos if combo in files}
    for key in ("weights_hash", "split", "score_thresholds"):
        if any(meta[key] != metas[0][key] for meta in metas):
            raise EvaluationError(f"--result: {key} differs: {', '.join(str(meta[key]) for meta in metas)}")
    return metas[0], {combo: found[combo] for combo in combos if combo in found}


def judge(combo: str, name: str, pairs: ClassPairs, labels: Sequence[Labels], region, min_score: float) -> Judged:
    seen = np.concatenate([_seen(each, combo)[each.names == name] for each in labels])
    how = region, HARDEST, STRICT_IOU[name], min_score
    frame = np.repeat(np.arange(len(labels)), np.diff(pairs.truth_start))
    distance = np.linalg.norm(pairs.truth_boxes[:, :2], axis=1)
    return Judged(combo, name, object_kinds(pairs, *how, seen), false_kinds(pairs, *how), distance, frame)


def _seen(labels: Labels, combo: str) -> np.ndarray:
    """(N,) bool: by a sensor of the combination."""
    used = SensorSet.parse(combo)
    return seen_by_source(labels)[:, [getattr(used, source) for source in SOURCES]].any(1)


def rows_of(judged: Judged) -> list[dict]:
    """A row for each range of distances: how many objects of each kind."""
    rows = []
    for low, high in pairwise(EDGES_M):
        kinds = judged.kinds[(judged.distance_m >= low) & (judged.distance_m < high)]
        counts = {kind: int((kinds == index).sum()) for index, kind in enumerate(OBJECT_KINDS)}
        rows.append({"combo": judged.combo, "class": judged.name, "from_m": low, "to_m": high, **counts})
    return rows


def tables(everything: Sequence[Judged]) -> str:
    """Markdown: of all objects, the share of each kind; of all false detections, how many there are of each kind."""
    objects, false = [], []
    for each in everything:
        counts = np.bincount(each.kinds[each.kinds >= 0], minlength=len(OBJECT_KINDS))
        shares = [f"{100 * count / max(counts.sum(), 1):.1f}" for count in counts]
        objects.append([each.combo, each.name, str(counts.sum()), *shares])
        false.append([each.combo, each.name, *map(str, np.bincount(each.false, minlength=len(FALSE_KINDS)))])
    header = ["", ""]
    return "\n".join(
        [
            "Objects (%):\n",
            *markdown_table([*header, "objects", *OBJECT_KINDS], objects),
            "\nFalse detections:\n",
            *markdown_table([*header, *FALSE_KINDS], false),
        ]
    )


def plot(everything: Sequence[Judged], title: str, file: Path) -> None:
    """Stacked bars: kinds of objects by distance; a row for each class, a column for each combination."""
    combos, names = (list(dict.fromkeys(getattr(e, key) for e in everything)) for key in ("combo", "name"))
    size = 0.6 + 2.4 * len(combos), 0.8 + 2.3 * len(names)
    figure, axes = plt.subplots(len(names), len(combos), figsize=size, squeeze=False, sharey="row")
    for each in everything:
        ax, bottom, rows = axes[names.index(each.name), combos.index(each.combo)], 0, rows_of(each)
        places = [f"{row['from_m']:g}-{row['to_m']:g}" for row in rows]
        for kind in OBJECT_KINDS:
            heights = np.array([row[kind] for row in rows])
            ax.bar(places, heights, bottom=bottom, color=KIND_INKS[kind], label=kind, width=0.8)
            bottom = bottom + heights
        ax.set_title(f"{each.name}, {each.combo}", fontsize=9)
        ax.tick_params(labelsize=7)
    for ax in axes[-1]:
        ax.set_xlabel("distance (m)", fontsize=8)
    for ax in axes[:, 0]:
        ax.set_ylabel("objects", fontsize=8)
    handles, kinds = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, kinds, ncols=len(kinds), loc="lower center", fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=10)
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    figure.savefig(file, dpi=130)
    plt.close(figure)


def draw_pictures(dataset, everything: Sequence[Judged], found: Sequence[Detections], combo: str, out: Path) -> None:
    """For each kind of miss the frame that has most of it, of both classes together; one scene is not drawn twice."""
    mine, drawn, grid = [each for each in everything if each.combo == combo], set(), dataset.prepare_config.grid
    for kind in MISSES:
        counts = sum(
            np.bincount(each.frame[each.kinds == OBJECT_KINDS.index(kind)], minlength=len(found)) for each in mine
        )
        for index in np.argsort(-counts, kind="stable"):
            scene = found[index].frame_id.rpartition("/")[0]
            if counts[index] and scene not in drawn:
                drawn.add(scene)
                kinds = {each.name: each.kinds[each.frame == index] for each in mine}
                image = miss_picture(dataset.read(index, SensorSet.parse(combo)), grid, combo, found[index], kinds)
                file = out / f"{kind.replace(' ', '_')}_{combo}_{flat_name(found[index].frame_id)}.jpg"
                write_picture(file, image)
                print(f"wrote {file}")
                break


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    meta, found = read_results(args.result, parse_combos(args.combos))
    out = args.out or args.result[0] / "misses"
    make_folder(out)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=meta["split"])
    min_scores, truths, region = meta["score_thresholds"] or {}, dataset.ground_truths(), dataset.regions()[0]
    labels = [dataset.read_labels(index).labels for index in range(len(dataset))]
    labels = [each.select(~centre_in_ego(each.boxes)) for each in labels]
    everything = []
    for combo, detections in tqdm(found.items(), unit="combination", desc="judging"):
        check_aligned(truths, detections)
        for name in dataset.class_names:
            pairs = pair_up(truths, detections, name)
            everything.append(judge(combo, name, pairs, labels, region, min_scores.get(name, MIN_SCORE)))
    scores = ", ".join(f"{name} {min_scores.get(name, MIN_SCORE):.2f}" for name in dataset.class_names)
    title = f"{meta['config']}, {meta['checkpoint']}, {len(dataset)} frames of {meta['split']}, scores {scores}"
    plot(everything, title, out / "misses.png")
    rows = [row for each in everything for row in rows_of(each)]
    write_json(out / "misses.json", {"meta": meta, "rows": rows})
    text = f"{title}, region {region.name}\n\n{tables(everything)}\n"
    write_text(out / "misses.md", text)
    print(f"\n{text}\nwritten to {out}")
    combo = args.pictures_of or next(iter(found))
    if combo not in found:
        raise EvaluationError(f"--pictures_of {combo}: expected one of {', '.join(found)}")
    draw_pictures(dataset, everything, [above_scores(each, min_scores) for each in found[combo]], combo, out)


if __name__ == "__main__":
    run_tool(main)
