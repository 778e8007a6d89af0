"""``--runtime``, ``--exported`` and ``--precision``: who computes the network, and in which number format."""

from __future__ import annotations

import argparse

from pcdet_avp.argument_types import path
from pcdet_avp.deploy.runtime import PRECISIONS, RUNTIMES, TORCH
from pcdet_avp.errors import ConfigError


def add_runtime_arguments(parser: argparse.ArgumentParser) -> None:
    """All three arguments; ``check_runtime_arguments`` looks at them."""
    names, default = (TORCH, *RUNTIMES), f"who computes the network (default: {TORCH})"
    parser.add_argument("--runtime", choices=names, default=TORCH, help=default)
    parser.add_argument("--exported", type=path, metavar="DIR", help="for the others: what tools/export.py wrote")
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default=PRECISIONS[0],
        help=f"of the convolutions, for --runtime {TORCH} (default: auto, bf16 on CPUs with instructions for it)",
    )


def check_runtime_arguments(args: argparse.Namespace) -> None:
    """ConfigError where ``--runtime``, ``--exported`` and ``--ckpt`` do not belong together."""
    if args.runtime == TORCH and args.exported:
        raise ConfigError(f"--exported belongs to --runtime {' or '.join(RUNTIMES)}, found {TORCH}")
    if args.runtime != TORCH and not args.exported:
        raise ConfigError(f"--runtime {args.runtime} needs --exported DIR, which tools/export.py writes")
    if args.runtime != TORCH and args.precision == "bf16":
        raise ConfigError(f"--precision bf16 belongs to --runtime {TORCH}; {args.runtime} computes in float32")
    if args.runtime != TORCH and args.ckpt:
        raise ConfigError(
            f"--ckpt belongs to --runtime {TORCH}; --runtime {args.runtime} has its weights in --exported"
        )


def precision_on_cpu(args: argparse.Namespace) -> str:
    """float32 or bf16: what ``--runtime`` and ``--precision`` come to on this machine's CPU."""
    if args.runtime != TORCH:
        return "float32"
    import torch  # nobody else here needs it

    from pcdet_avp.models.precision import chosen_precision

    return chosen_precision(args.precision, torch.device("cpu"))
