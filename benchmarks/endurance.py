"""Endurance: a million damaged payloads, and long work that is killed at random moments.

    python benchmarks/endurance.py [--payloads 1000000] [--kills 50] [--seed 0] [--out output/endurance]

Payloads (``endurance_payloads``): only the documented error may come out of a decoder, memory must stay below a
ceiling, and no damage that a checksum refuses may be taken. Kills (``endurance_kills``, ``endurance_works``): data
making, a training and a sweep are killed so often each; nothing that was finished may be lost, and records, last
checkpoints and episodes must be those of an uninterrupted run, byte by byte (of a checkpoint all but the seconds that
it took).

Prints a table and writes it to endurance.md and endurance.json in ``--out``. Interrupt it when you like: the same
command goes on after the last finished batch of payloads or round of kills. A fault ends in exit status 2 and stands
in endurance.json. Payloads follow from the seed alone; moments of kills are drawn from it, but what they hit is up to
the machine. Needs POSIX (fork, process groups).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads do not survive a fork

from tqdm import tqdm

from pcdet_avp.argument_types import non_negative_int, path
from pcdet_avp.cli import run_tool
from pcdet_avp.errors import EvaluationError, RecordError
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import make_folder, write_json, write_text
from pcdet_avp.provenance import command, git_commit, machine

ROOT = Path(__file__).parents[1]
WARM_UP = 3  # batches until all is compiled and the largest buffers have been needed once
CEILING_MB = 400.0  # growth of the process: six held maps of 24 MB, one on its way, one that is taken as float32
WORKS = ["data making", "training", "sweep"]
PAYLOADS, KILLS, CLAIM = "payloads.jsonl", "kills.jsonl", "claim.json"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Damaged payloads and killed work, counted.")
    parser.add_argument("--payloads", type=non_negative_int, default=1_000_000, help="damaged payloads; 0: none")
    parser.add_argument("--kills", type=non_negative_int, default=50, help="of each work; 0: none")
    parser.add_argument("--works", nargs="+", default=WORKS, choices=WORKS, help="what is killed (default: all)")
    parser.add_argument("--seed", type=non_negative_int, default=0)
    asn1 = ROOT / "tests" / "link" / "asn1"
    parser.add_argument("--cpm_asn1", type=path, default=asn1, help="folder of ASN.1 files (default: the tests' own)")
    parser.add_argument("--out", type=path, default=Path("output", "endurance"))
    return parser.parse_args()


class Lines:
    """A file of JSON lines, each appended whole; what a kill left of one is cut off when it is opened."""

    def __init__(self, file: Path) -> None:
        content = file.read_bytes() if file.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        self.entries = [json.loads(line) for line in whole.splitlines()]
        self._file = file.open("ab")
        self._file.truncate(len(whole))

    def add(self, entry: dict) -> None:
        self._file.write(json.dumps(entry).encode() + b"\n")
        self._file.flush()
        self.entries.append(entry)


def payloads(args: argparse.Namespace) -> list[dict]:
    """One entry for every batch: counts, the slowest payload, growth of memory, faults."""
    from endurance_payloads import PER_BATCH, Sent, attack

    lines = Lines(args.out / PAYLOADS)
    sent = Sent(args.cpm_asn1)
    for batch in range(WARM_UP):
        attack(sent, args.seed, batch)
    before = peak_mb()
    with tqdm(total=args.payloads, unit="payload", desc="payloads", initial=len(lines.entries) * PER_BATCH) as bar:
        while (done := sum(sum(e["counts"].values()) for e in lines.entries)) < args.payloads:
            batch = len(lines.entries)
            found = attack(sent, args.seed, batch, min(PER_BATCH, args.payloads - done))
            lines.add({"batch": batch, **vars(found), "grown_mb": round(peak_mb() - before, 1)})
            bar.update(sum(found.counts.values()))
    return lines.entries


def peak_mb() -> float:
    """The most memory that this process has held so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20) if sys.platform == "darwin" else peak / 1024


def kills(args: argparse.Namespace) -> list[dict]:
    """One entry for every round of every work."""
    import torch
    from endurance_kills import adopt_orphans, run_to_the_end
    from endurance_works import works

    torch.set_num_threads(1)
    tqdm.set_lock(threading.RLock())  # its own is shared by forks: one that is killed while it holds it would stop us
    adopt_orphans()
    _import_tools()
    lines, place = Lines(args.out / KILLS), args.out.resolve() / "work"
    data = place / "reference" / "data making"
    for index, work in enumerate(works(data / "data")):
        if work.name not in args.works and index > 0:  # the first one's data set is what the training learns from
            continue
        reference = place / "reference" / work.name
        whole = reference.with_name(f"{work.name}.json")
        if not whole.exists():
            shutil.rmtree(reference, ignore_errors=True)
            status, seconds = run_to_the_end(work, reference)
            if status:
                raise RecordError(f"{reference}.log: the uninterrupted run ended with exit status {status}")
            write_json(whole, {"seconds": seconds, "result": work.result(reference)})
        known = json.loads(whole.read_text())
        for entry in () if work.name not in args.works else _rounds(args, index, work, place, known, lines):
            lines.add(entry)
    return lines.entries


def _rounds(args: argparse.Namespace, index: int, work, place: Path, known: dict, lines: Lines) -> Iterator[dict]:
    """Rounds of one work until it has been killed often enough."""
    from endurance_kills import killed_round

    own = [entry for entry in lines.entries if entry["work"] == work.name]
    done = sum(entry["kills"] for entry in own)
    with tqdm(total=args.kills, initial=done, unit="kill", desc=work.name) as bar:
        for number in range(len(own), 100 * args.kills):
            if done >= args.kills:
                return
            folder = place / f"{work.name} {number}"
            shutil.rmtree(folder, ignore_errors=True)
            seed = [args.seed, index]
            for outcome in killed_round(
                work, folder, number, args.kills - done, known["seconds"], known["result"], seed
            ):
                bar.n = done + outcome.kills
                bar.refresh()
            done += outcome.kills
            if not outcome.faults:
                shutil.rmtree(folder, ignore_errors=True)
                folder.with_name(f"{folder.name}.log").unlink(missing_ok=True)
            yield asdict(outcome)


def _import_tools() -> None:
    """So that a fork has them: what the three tools import."""
    import pcdet_avp.commands.create_data
    import pcdet_avp.commands.safety_eval
    import pcdet_avp.commands.train  # noqa: F401


def report(batches: list[dict], rounds: list[dict], about: dict) -> tuple[str, list[str]]:
    """Markdown, and all faults."""
    counts: Counter[str] = Counter()
    for entry in batches:
        counts.update(entry["counts"])
    faults = [fault for entry in [*batches, *rounds] for fault in entry["faults"]]
    grown = max((entry["grown_mb"] for entry in batches), default=0.0)
    if grown > CEILING_MB:
        faults.append(f"memory grew by {grown} MB, expected at most {CEILING_MB}")
    parts = ["# Endurance", "; ".join(f"{key} {value}" for key, value in about.items()) + "."]
    if batches:
        rows = [[what, f"{number:,}"] for what, number in sorted(counts.items())]
        slowest = max(entry["slowest_s"] for entry in batches)
        parts += [
            f"## {sum(counts.values()):,} payloads",
            _table(["decoder: what became of it", "payloads"], rows),
        ]
        parts.append(
            f"Slowest payload {1e3 * slowest:.0f} ms. Memory grew by {grown:.0f} MB (ceiling {CEILING_MB:.0f})."
        )
    if rounds:
        parts += ["## Kills", _table(HEADER, _kill_rows(rounds))]
    parts.append(f"Faults: {len(faults)}.")
    return "\n\n".join(parts) + "\n", faults


def _table(header: list[str], rows: list[list[str]]) -> str:
    return "\n".join(markdown_table(header, rows))


HEADER = ["work", "kills", "of the whole group", "during a write", "half-written file left", "runs to the end"]
HEADER += ["compared with the uninterrupted run", "faults"]


def _kill_rows(rounds: list[dict]) -> list[list[str]]:
    rows = []
    for name in dict.fromkeys(entry["work"] for entry in rounds):
        own = [entry for entry in rounds if entry["work"] == name]
        sums = [sum(e[k] for e in own) for k in ("kills", "of_the_group", "at_a_write", "half_written")]
        rows.append([name, *map(str, sums), str(len(own)), str(sum(e["compared"] for e in own))])
        rows[-1].append(str(sum(len(e["faults"]) for e in own)))
    return rows


def claim(args: argparse.Namespace) -> None:
    """A folder belongs to one seed and one commit; RecordError where another one has begun in it."""
    make_folder(args.out)
    ours = {"seed": args.seed, "commit": git_commit(), "cpm_asn1": args.cpm_asn1.resolve().name}
    file = args.out / CLAIM
    if file.exists() and json.loads(file.read_text()) != ours:
        raise RecordError(
            f"{file}: belongs to {json.loads(file.read_text())}, this run is {ours}; choose another --out"
        )
    write_json(file, ours)


def main() -> None:
    args, started = parse_arguments(), time.time()
    claim(args)
    batches = payloads(args) if args.payloads else []
    rounds = kills(args) if args.kills else []
    processor = f"{machine()['processor']}, {machine()['cores']} cores, shared with other work"
    about = {"Command": f"`{command()}`", "seed": args.seed, "commit": git_commit(), "machine": processor}
    text, faults = report(batches, rounds, about)
    write_text(args.out / "endurance.md", text)
    write_json(args.out / "endurance.json", {**about, "payloads": batches, "kills": rounds, "faults": faults})
    print(f"\n{text}\nwritten to {args.out} after {time.time() - started:.0f} s")
    if faults:
        raise EvaluationError(f"{len(faults)} faults, the first: {faults[0]}")


if __name__ == "__main__":
    run_tool(main)
