"""``--runtime`` and ``--exported``: who computes the network, torch or a runtime of ``pcdet_avp.deploy``."""

from __future__ import annotations

import argparse

from pcdet_avp.argument_types import path
from pcdet_avp.deploy.runtime import RUNTIMES, TORCH
from pcdet_avp.errors import ConfigError


def add_runtime_arguments(parser: argparse.ArgumentParser) -> None:
    """Both arguments; ``check_runtime_arguments`` looks at them."""
    names, default = (TORCH, *RUNTIMES), f"who computes the network (default: {TORCH})"
    parser.add_argument("--runtime", choices=names, default=TORCH, help=default)
    parser.add_argument("--exported", type=path, metavar="DIR", help="for the others: what tools/export.py wrote")


def check_runtime_arguments(args: argparse.Namespace) -> None:
    """ConfigError where ``--runtime``, ``--exported`` and ``--ckpt`` do not belong together."""
    if args.runtime == TORCH and args.exported:
        raise ConfigError(f"--exported belongs to --runtime {' or '.join(RUNTIMES)}, found {TORCH}")
    if args.runtime != TORCH and not args.exported:
        raise ConfigError(f"--runtime {args.runtime} needs --exported DIR, which tools/export.py writes")
    if args.runtime != TORCH and args.ckpt:
        raise ConfigError(
            f"--ckpt belongs to --runtime {TORCH}; --runtime {args.runtime} has its weights in --exported"
        )
