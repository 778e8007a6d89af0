"""Folders of the tour's results, and their names in its commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pcdet_avp.closed_loop.sweep.results import Results, read_results
from pcdet_avp.engine.outputs import RunFolder
from pcdet_avp.tour.pictures import DataSet
from pcdet_avp.tour.results import Benchmark, read_json

CFG_FILE = "cfgs/avp/cp_small.yaml"
SCENES, SEED = 60, 7  # another seed than that of the data the weights were trained on: other garages, other people
SPLIT, TAG = "test", "tour"


@dataclass(frozen=True)
class Place:
    """The tour's folder and its weights, as the user names them; what the commands left there, and the arguments that
    they share."""

    out: Path
    weights: str

    @property
    def data(self) -> DataSet:
        return DataSet(self.out / "data", CFG_FILE)

    @property
    def table_file(self) -> Path:
        """The table that testing leaves in the folder of its run."""
        return RunFolder.of(CFG_FILE, TAG).evaluation / Path(self.weights).stem / SPLIT / TAG / "table.md"

    def benchmark(self) -> Benchmark:
        return Benchmark.read(self.out / "benchmark.json", self.table_file)

    def bandwidth(self) -> dict:
        return read_json(self.out / "bandwidth" / "bandwidth.json")

    def sweep(self, name: str) -> Results:
        """``los`` or ``model``."""
        return read_results(self.out / name)

    @property
    def cfg_arguments(self) -> list[str]:
        return ["--cfg", CFG_FILE]

    @property
    def network_arguments(self) -> list[str]:
        """Network and weights."""
        return [*self.cfg_arguments, "--ckpt", self.weights]

    @property
    def data_arguments(self) -> list[str]:
        """The tour's own data set; they end a command line."""
        values = {"DATA_PATH": self.path("data"), "GENERATE.SCENES": SCENES, "GENERATE.SEED": SEED}
        return ["--set", *(word for key, value in values.items() for word in (f"DATA_CONFIG.{key}", str(value)))]

    def path(self, name: str) -> str:
        """A path as commands name it."""
        return str(self.out / name)
