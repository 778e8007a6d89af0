"""What the tour runs, in the order of the data's way, and what its page shows of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pcdet_avp.tour import parts
from pcdet_avp.tour.pictures import preview_pictures
from pcdet_avp.tour.place import TAG, Place
from pcdet_avp.tour.step import Step
from pcdet_avp.tour.summary import ALONE, TOGETHER, Findings
from pcdet_avp.visualization.page import Video

SCENARIO, SPEED_MPS = "t_junction", 8.0
PICTURES = 2  # of frames, and of detections


@dataclass(frozen=True)
class Tour:
    """Settings of a tour: folder of the results, minutes of training, number of the network's episodes."""

    place: Place
    train_minutes: float
    episodes: int

    def steps(self) -> dict[str, Step]:
        """The tour's steps by name, in their order."""
        steps = {
            "see": self._see(),
            "detect": self._detect(),
            "show": self._show(),
            "send": self._send(),
            "limit": self._limit(),
            "drive": self._drive(),
        }
        return steps | {"train": self._train()} if self.train_minutes > 0 else steps

    def findings(self, done: Sequence[str]) -> Findings:
        """The results of those steps that are done."""
        return Findings(
            SCENARIO,
            SPEED_MPS,
            benchmark=self.place.benchmark() if "detect" in done else None,
            bandwidth=self.place.bandwidth() if "send" in done else None,
            line_of_sight=self.place.sweep("los") if "limit" in done else None,
            model=self.place.sweep("model") if "drive" in done else None,
        )

    def lead(self, done: Sequence[str]) -> list[Video]:
        """The video that the page starts with: the network drives with the roadside."""
        return [parts.episode_of(self.place, SCENARIO, TOGETHER)] if "drive" in done else []

    def _see(self) -> Step:
        place = self.place
        return Step(
            "What the car and the roadside see",
            "Every scene has a garage of its own; a mast at the junction carries the roadside's camera and LiDAR. "
            "Shown are the frames with the most pedestrians that only the roadside sees, as long as the vehicle's "
            "camera sees as many road users well; one frame of a scene.",
            ["create_data", *place.cfg_arguments, "--preview", str(PICTURES), *place.data_arguments],
            lambda: preview_pictures(place.data, PICTURES, place.out / "narrow"),
        )

    def _detect(self) -> Step:
        tags = ["--extra_tag", TAG, "--eval_tag", TAG, "--wire", "--json", self.place.path("benchmark.json")]
        return Step(
            "What is detected without and with the roadside",
            "Average precision on garages that the network never saw. Every roadside map was encoded to bytes and "
            "decoded again.",
            ["test", *self.place.network_arguments, *tags, *self.place.data_arguments],
            lambda: parts.benchmark_parts(self.place),
        )

    def _show(self) -> Step:
        what = ["--pictures", str(PICTURES), "--out", self.place.path("demo")]
        return Step(
            "Detections in pictures",
            "Frames of garages that the network never saw, chosen as those above: by labels, before anything was "
            "detected.",
            ["demo", *self.place.network_arguments, *what, *self.place.data_arguments],
            lambda: parts.demo_pictures(self.place, PICTURES),
        )

    def _send(self) -> Step:
        what = ["--every", "3", "--combos", TOGETHER, "--studies", "budget,loss", "--out", self.place.path("bandwidth")]
        return Step(
            "How many bytes the roadside sends",
            "Feature maps as they go on the air, and what they are worth when transport blocks are lost.",
            ["bandwidth_report", *self.place.network_arguments, *what, *self.place.data_arguments],
            lambda: parts.bandwidth_parts(self.place),
        )

    def _limit(self) -> Step:
        what = ["--scenario", SCENARIO, "--perception", "los", "--trials", "10", "--search"]
        return Step(
            "How fast the car may drive if everything in line of sight is known",
            "No network is involved: what any sensor in use has in line of sight is known at once. That is the limit "
            "of the sensors' places.",
            ["safety_eval", *what, "--out", self.place.path("los")],
            lambda: parts.limit_parts(self.place, SCENARIO),
        )

    def _drive(self) -> Step:
        what = ["--scenario", SCENARIO, "--perception", "model", "--combos", f"{ALONE},{TOGETHER}"]
        how = ["--speeds", f"{SPEED_MPS:g}", "--trials", str(self.episodes), "--video"]
        return Step(
            f"Driving with the trained network at {SPEED_MPS:g} m/s",
            "Rendered cameras and LiDARs, encoded roadside maps, detection and braking in a closed loop. So few "
            "episodes show how it works; they do not tell a rate.",
            ["safety_eval", *self.place.network_arguments, *what, *how, "--out", self.place.path("model")],
            lambda: parts.drive_parts(self.place, SCENARIO, SPEED_MPS, ALONE),
        )

    def _train(self) -> Step:
        how = ["--extra_tag", TAG, "--max_minutes", f"{self.train_minutes:g}", "--no_eval"]
        return Step(
            "Training",
            f"{self.train_minutes:g} minutes of training from scratch, to see it at work; such weights detect little. "
            "`tensorboard --logdir output` shows its curves and pictures.",
            ["train", *self.place.cfg_arguments, *how, *self.place.data_arguments],
        )
