"""The tour's page: what the roadside changed, the video, every step, how to go on, and where it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pcdet_avp import __version__
from pcdet_avp.cli import program
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.provenance import git_commit, machine, versions
from pcdet_avp.tour.place import SCENES, SEED
from pcdet_avp.tour.results import short_commit
from pcdet_avp.tour.steps import Tour
from pcdet_avp.tour.summary import comparisons, summary
from pcdet_avp.visualization.page import Page, Section, Table

TITLE = "What roadside sensors change for a car that parks itself"
COMMANDS = (  # what for; a module of pcdet_avp.commands and its arguments
    ("train `cp_small` from scratch on two CPU cores", "train --cfg cfgs/avp/cp_small_scratch.yaml"),
    ("train the paper's size on a GPU", "train --cfg cfgs/avp/cp_full.yaml --use_amp"),
    ("test weights of yours beside the paper's", "test --cfg cfgs/avp/cp_small.yaml --ckpt FILE --wire"),
    (
        "fill the paper's crash table with the network, with videos",
        "safety_eval --cfg cfgs/avp/cp_small.yaml --scenario t_junction --perception model --video",
    ),
    (
        "the same for pedestrians between parked cars, without a network",
        "safety_eval --scenario pedestrian_late --perception los --search",
    ),
    ("make the paper's data set", "create_data --cfg cfgs/dataset_configs/avp_full.yaml"),
)


def tour_page(tour: Tour, done: Sequence[str]) -> Page:
    """The page after the steps named in ``done``. ConfigError where one of their results is missing."""
    findings, steps = tour.findings(done), tour.steps()
    return Page(
        TITLE,
        f"`pcdet_avp` {__version__}: infrastructure-assisted collaborative perception in automated valet parking. "
        "Everything on this page comes from one run of `make run` on the embedded garage.",
        summary(findings),
        comparisons(findings),
        tour.lead(done),
        [*(steps[name].section() for name in done), _next_section()],
        _about(tour, findings),
    )


def _next_section() -> Section:
    body = []
    for what, words in COMMANDS:
        module, _, arguments = words.partition(" ")
        body.append([what, f"`{' '.join(program(module))} {arguments}`"])
    table = Table("**Commands to go on with**", markdown_table(["to", "command"], body))
    return Section(
        "How to go on",
        "Every command can be stopped and goes on where it was. `README.md` and `docs/` say more; "
        "`docs/closed_loop.md` shows how your own perception or controller plugs into the closed loop.",
        parts=[table],
    )


def _about(tour: Tour, findings) -> dict[str, str]:
    meta = findings.benchmark.meta if findings.benchmark else {}
    facts = {
        "data": f"{SCENES} scenes, seed {SEED}",
        "weights": f"{Path(tour.place.weights).name} {meta.get('weights_hash') or ''}".strip(),
        "commit": short_commit(git_commit() or "not a checkout"),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
        "machine": ", ".join(f"{name} {value}" for name, value in machine().items() if value is not None),
    }
    return facts
