"""``avp-import``: a recording in another layout as a data set of ours, or the rest of an import that was interrupted.

Prints what was left out and what was repaired; docs/own_data.md says what each layout becomes.
"""

from __future__ import annotations

import argparse
import shlex
from functools import partial

from pcdet_avp.argument_types import Parser, non_negative_int, path
from pcdet_avp.cli import program, run_tool
from pcdet_avp.datasets.importers.run import FORMATS, import_recording, open_recording, read_splits


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="A recording in another layout as a data set of ours.")
    parser.add_argument("--format", required=True, choices=sorted(FORMATS), help="its layout")
    parser.add_argument("--src", type=path, required=True, help="its folder")
    parser.add_argument("--out", type=path, required=True, help="folder of the data set: new, empty, or begun before")
    parser.add_argument("--splits", type=path, help='JSON {"train": [scenes], "val": [...], "test": [...]}')
    parser.add_argument("--seed", type=non_negative_int, default=0, help="draws the splits that nothing else tells")
    parser.add_argument("--skip_missing", action="store_true", help="leave out frames that lack a file")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    recording, out = open_recording(args.format, args.src), args.out.resolve()
    splits = None if args.splits is None else read_splits(args.splits)
    manifest = import_recording(
        recording, args.format, out, splits=splits, seed=args.seed, skip_missing=args.skip_missing
    )
    for line in recording.notes.lines():
        print(line)
    print(f"wrote {out}: " + ", ".join(f"{split} {count} frames" for split, count in manifest.frame_counts.items()))
    where, classes = shlex.quote(str(out)), f' CLASS_NAMES "[{", ".join(manifest.class_names)}]"'
    print(f"read it with: {' '.join(program('train'))} --cfg C --set DATA_CONFIG.DATA_PATH {where}{classes}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
