"""The pictures and videos of the tour's page, each with its caption."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pcdet_avp.closed_loop.report.report import SCENARIOS
from pcdet_avp.closed_loop.sweep.results import Results
from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import flat_name
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import Frame
from pcdet_avp.tour.tables import SENSORS
from pcdet_avp.visualization.draw import WIDTH_PX, stacked
from pcdet_avp.visualization.frame_choice import TellingFrame, telling_frames
from pcdet_avp.visualization.page import Picture, Video
from pcdet_avp.visualization.video import read_picture, write_picture


@dataclass(frozen=True)
class DataSet:
    """The tour's data set; ``cfg_file`` describes it."""

    root: Path
    cfg_file: str

    @cached_property
    def grid(self) -> BevGrid:
        cfg = load_config(self.cfg_file).DATA_CONFIG
        return BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE)

    def frames(self, split: str | None = None) -> Iterator[Frame]:
        """Poses, calibration and labels of all frames, or of those of a split."""
        for scene in read_manifest(self.root).scenes:
            if split in (None, scene.split):
                yield from (read_frame(self.root, frame_id, sources=()) for frame_id in scene.frame_ids)

    def telling(self, count: int, split: str | None = None) -> list[TellingFrame]:
        return telling_frames(self.frames(split), self.grid, count)


def preview_pictures(data: DataSet, count: int, narrow_folder: Path) -> list[Picture]:
    """What ``create_data.py --preview`` drew: both cameras, both clouds from above."""
    return [
        Picture(
            data.root / "preview" / _name(chosen),
            f"Frame {chosen.frame_id}: vehicle camera, roadside camera, and both point clouds from above with boxes.",
            f"{_counts(chosen)} Boxes are green where the vehicle's camera sees most of a road user, amber where it "
            "sees part of it, red where it sees next to nothing. Below, both point clouds from above: the vehicle's "
            "in blue, the roadside's in orange.",
            _narrow(data, chosen, data.root / "preview", narrow_folder, panels=1),
        )
        for chosen in data.telling(count)
    ]


def detection_pictures(data: DataSet, split: str, count: int, folder: Path, narrow_folder: Path) -> list[Picture]:
    """What ``demo.py --pictures`` drew: detections without and with the roadside."""
    return [
        Picture(
            folder / _name(chosen),
            f"Frame {chosen.frame_id}: detections on both camera images, and from above without and with the roadside.",
            f"{_counts(chosen)} Detected cars are amber, detected pedestrians pink, true boxes thin and green. The "
            "views from above: first with the vehicle's camera and LiDAR alone (`CL+none`), then with the roadside's "
            "as well (`CL+CL`).",
            _narrow(data, chosen, folder, narrow_folder, panels=2),
        )
        for chosen in data.telling(count, split)
    ]


def _name(chosen: TellingFrame) -> str:
    return f"{flat_name(chosen.frame_id)}.png"


def _counts(chosen: TellingFrame) -> str:
    return (
        f"**Frame {chosen.frame_id}: {chosen.hidden} pedestrians that only the roadside sees; the vehicle's camera "
        f"sees {chosen.shown} road users well.**"
    )


def _narrow(data: DataSet, chosen: TellingFrame, folder: Path, narrow_folder: Path, panels: int) -> Path:
    """The picture of a frame with its panels below one another; ``panels``: how many the lower row has."""
    image = read_picture(folder / _name(chosen))
    camera = read_frame(data.root, chosen.frame_id, sources=()).ego.camera
    above = round(WIDTH_PX // 2 * camera.height / camera.width)
    file = narrow_folder / f"{folder.name}_{_name(chosen)}"
    write_picture(file, stacked(image, [(above, 2), (image.shape[0] - above, panels)]))
    return file


LEGENDS = {  # by whether the roadside is used
    True: "Left: both cameras. Right: the garage from above with true road users green, what is detected with the "
    "roadside pink, and what the same vehicle would detect alone blue. Below: the car's speed, its target speed, and "
    "the target speed that the vehicle's own detections would ask for.",
    False: "Left: both cameras, of which the roadside's is not used. Right: the garage from above with true road users "
    "green and detected ones pink. Below: the car's speed and its target speed.",
}


def episode_video(results: Results, scenario: str, perception: str, combo: str, folder: Path) -> Video:
    """The newest video of one combination of a sweep; ConfigError where there is none."""
    stem = _newest(folder, f"{scenario}_{perception}_{combo}_")
    speed, trial = stem.rsplit("_", 2)[1:]
    how = _outcome(results, scenario, perception, combo, float(speed), trial)
    where, who = f"{SCENARIOS[scenario].title}, {speed} m/s", f"{results.meta.get('config')} with {_sensors(combo)}"
    return Video(
        next(file for file in folder.glob(f"{stem}.*")),
        f"Video: {where}, driven by {who}; {how}.",
        f"**{where}, episode {trial}, driven by {who}: {how}.** {LEGENDS[not combo.endswith('+none')]}",
        folder / f"{stem}_poster.jpg",
        folder / f"{stem}_stills.jpg",
    )


def _newest(folder: Path, start: str) -> str:
    """The stem of a video; its stills are written last."""
    stills = sorted(folder.glob(f"{start}*_stills.jpg"), key=lambda file: (file.stat().st_mtime, file.name))
    if not stills:
        raise ConfigError(f"{folder}: expected a video {start}..., found none")
    return stills[-1].stem.removesuffix("_stills")


def _sensors(combo: str) -> str:
    vehicle, roadside = (SENSORS[part].replace(", ", " and ") for part in combo.split("+"))
    return f"the vehicle's {vehicle}" + (" alone" if roadside == "none" else f" and the roadside's {roadside}")


def _outcome(results: Results, scenario: str, perception: str, combo: str, speed: float, trial: str) -> str:
    episodes = results.row(scenario, perception, combo)[speed].episodes
    row = next(row for row in episodes if row["trial"] == trial)
    if row["outcome"] == "none":
        return "no contact"
    return f"contact with the car's {row['outcome']} at {float(row['impact_speed_mps']):.1f} m/s"
