"""What the command-line tools share: the configuration arguments, and errors printed as one line."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from importlib.metadata import entry_points

from easydict import EasyDict

from pcdet_avp import shipped
from pcdet_avp.argument_types import Parser, path_text
from pcdet_avp.config import apply_overrides, ignoring, load_config
from pcdet_avp.config_check import check_values
from pcdet_avp.errors import AvpError
from pcdet_avp.files import remove_empty_folders

# torch's threads spin while they wait for one another. On cores that they share with processes that load data, or
# with anyone else, that makes training five times slower. To be woken for every operation costs a frame's inference
# on two threads a tenth of its time: they spin for some tens of microseconds. OpenMP reads both when torch is first
# imported, after us.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

CKPT_HELP = "checkpoint (default: the newest of the run, or the weights that come with the package)"
COMMANDS = "pcdet_avp.commands"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def config_parser(description: str, default: str | None = None, weights: bool = False) -> argparse.ArgumentParser:
    """A parser with ``--cfg`` (also ``--cfg_file``; required where there is no default) and ``--set``.

    ``weights``: also ``--ignore_config``, for a tool that loads weights.
    """
    parser = Parser(description=description)
    parser.add_argument(
        "--cfg",
        "--cfg_file",
        dest="cfg",
        type=path_text,
        required=default is None,
        default=default,
        metavar="FILE",
        help="configuration (YAML)" + (f" (default: {os.path.basename(default)})" if default else ""),
    )
    if weights:
        parser.add_argument(
            "--ignore_config",
            nargs="+",
            default=[],
            metavar="KEY",
            help="use weights although this key or section of the configuration differs from theirs",
        )
    parser.add_argument(
        "--set", dest="overrides", nargs=argparse.REMAINDER, default=[], metavar="KEY VALUE", help="override keys; last"
    )
    return parser


def load_arguments_config(args: argparse.Namespace) -> EasyDict:
    """The configuration that ``--cfg``, ``--set`` and ``--ignore_config`` describe, its values checked."""
    cfg = ignoring(apply_overrides(load_config(args.cfg), args.overrides), getattr(args, "ignore_config", ()))
    check_values(cfg)
    return cfg


def run_tool(main: Callable[[], None]) -> None:
    """Run a tool; a wrong input ends in one line and exit status 2, and leaves no empty folder; Ctrl-C ends in 130.

    So does SIGTERM, by which batch systems and containers end a process: no half-written file stays.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main()
    except AvpError as error:
        remove_empty_folders()
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except (KeyboardInterrupt, SystemError) as error:
        if not _is_interrupt(error):
            raise
        print("interrupted; the same command goes on from here", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether it is Ctrl-C: Python makes a SystemError of one that arrives inside numba's compiled code."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def program(module: str) -> list[str]:
    """The words that start a command: its console script, or in a checkout the file in tools/.

    ``module``: its name in ``pcdet_avp.commands``.
    """
    if not shipped.INSTALLED:
        return ["python", f"tools/{module}.py"]
    scripts = entry_points(group="console_scripts")
    names = [script.name for script in scripts if script.value == f"{COMMANDS}.{module}:run"]
    return names[:1] or ["python", "-m", f"{COMMANDS}.{module}"]
