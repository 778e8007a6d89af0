"""``tools/export_openpcdet.py``: a configuration as one file that OpenPCDet's own scripts accept."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from pcdet_avp import shipped
from pcdet_avp.argument_types import Parser, path
from pcdet_avp.cli import run_tool
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import write_text
from pcdet_avp.openpcdet.config import openpcdet_yaml

NAMES = ("cp_tiny", "cp_small", "cp_small_first", "cp_full")
FOLDER = Path("cfgs") / "openpcdet"


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="Configurations for OpenPCDet's own scripts.")
    parser.add_argument("--cfg", "--cfg_file", dest="cfg", metavar="FILE", help=f"default: {', '.join(NAMES)}")
    parser.add_argument("--out", type=path, metavar="FILE", help="file to write, with --cfg")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    if (args.cfg is None) != (args.out is None):
        raise ConfigError("--cfg and --out belong together; without both, cfgs/openpcdet/ is written")
    if args.cfg:
        export(args.cfg, Path(args.cfg), args.out)
        return
    for source in (f"cfgs/avp/{name}.yaml" for name in NAMES):
        export(source, shipped.ROOT / source, shipped.home() / FOLDER / Path(source).name)


def export(source: str, path: Path, out: Path) -> None:
    write_text(out, openpcdet_yaml(load_config(path), source, out.name))
    print(f"wrote {out}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
