"""What the page shows of each step: read from what the step's command left."""

from __future__ import annotations

from pcdet_avp.closed_loop.report.report import FIGURES, REPORT
from pcdet_avp.tour import tables
from pcdet_avp.tour.pictures import detection_pictures, episode_video
from pcdet_avp.tour.place import SEED, SPLIT, Place
from pcdet_avp.visualization.page import Picture, Report, Video
from pcdet_avp.visualization.page.parts import Part


def benchmark_parts(place: Place) -> list[Part]:
    return [
        tables.benchmark_table(place.benchmark(), SEED),
        Report("All columns, both regions, intervals", place.table_file),
    ]


def demo_pictures(place: Place, count: int) -> list[Picture]:
    return detection_pictures(place.data, SPLIT, count, place.out / "demo", place.out / "narrow")


def bandwidth_parts(place: Place) -> list[Part]:
    content, folder = place.bandwidth(), place.out / "bandwidth"
    caption = "AP against the share of transport blocks lost; dotted: the vehicle alone."
    return [
        tables.bytes_table(content, SEED),
        *tables.loss_tables(content, SEED),
        Picture(folder / "ap_loss.png", f"Chart: {caption}", caption, is_plot=True),
        Report("The whole report: budgets, sizes, age of the maps", folder / "report.md"),
    ]


def limit_parts(place: Place, scenario: str) -> list[Part]:
    folder = place.out / "los"
    caption = "Crash rate against cruising speed with its 95 % interval, one panel a vehicle; dotted: the paper."
    return [
        tables.speed_table(place.sweep("los"), scenario, "los"),
        Picture(folder / FIGURES / f"crashes_{scenario}_los.png", f"Chart: {caption}", caption, is_plot=True),
        Report("The whole report: pace, contacts, first detections", folder / REPORT),
    ]


def drive_parts(place: Place, scenario: str, speed_mps: float, combo: str) -> list[Part]:
    """``combo``: whose video is shown here."""
    return [
        tables.drive_table(place.sweep("model"), scenario, "model", speed_mps),
        episode_of(place, scenario, combo),
        Report("The whole report: pace, contacts, what was missed", place.out / "model" / REPORT),
    ]


def episode_of(place: Place, scenario: str, combo: str) -> Video:
    """The video of an episode that the network drove with a sensor combination."""
    return episode_video(place.sweep("model"), scenario, "model", combo, place.out / "model" / "videos")
