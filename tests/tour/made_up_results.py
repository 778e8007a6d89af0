"""A tour's folder with results made up by hand, so that every number on its page is known."""

import csv
import json

import cv2
import numpy as np

from pcdet_avp.closed_loop.report.report import write_report
from pcdet_avp.commands.create_data import write_previews
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.structures.sensor_set import SENSOR_SETS
from pcdet_avp.tour.place import SPLIT, Place
from pcdet_avp.visualization.video import write_picture, write_video

STEPS = ("see", "detect", "show", "send", "limit", "drive", "train")
META = {"config": "cp_small", "seed": 3, "git_commit": "0123456789abcdef", "weights_hash": "feed", "frames": 42}
# Overall AP of Car and Pedestrian by combination.
AP = {
    "C+none": (21.5, 11.25),
    "C+C": (40.0, 30.0),
    "C+CL": (70.5, 60.0),
    "CL+none": (71.0, 61.5),
    "CL+C": (75.0, 65.0),
    "CL+CL": (82.5, 91.0),
}
EPISODE = {
    "finished": True,
    "crash_time_s": "",
    "impact_speed_mps": 0.0,
    "min_distance_m": 1.5,
    "min_ttc_s": "inf",
    "hardest_deceleration_mps2": 4.0,
    "mean_speed_mps": 2.5,
    "false_brake_share": 0.04,
    "first_detection_m": 14.0,
    "missed_outside": 0,
    "missed_occluded": 3,
    "messages": 0,
    "message_bytes": "",
    "message_age_s": "",
}
SENT = {"messages": 20, "message_bytes": 5500.0, "message_age_s": 0.05}


def make_tour(folder, data):
    """Everything that the page of a tour in ``folder`` reads; the working folder must be ``folder``."""
    place = Place(folder, "weights/cp_small.pth")
    (folder / "data").symlink_to(data)
    write_previews(place.out / "data", read_manifest(data), place.data.grid, 2)
    for chosen in place.data.telling(2, SPLIT):
        image = np.full((700, 1600, 3), 90, np.uint8)
        write_picture(folder / "demo" / f"{chosen.frame_id.replace('/', '_')}.png", image)
    make_benchmark(place)
    make_bandwidth(folder / "bandwidth")
    los = {("CL+none", 7.0): (0, 20), ("CL+none", 8.0): (4, 20), ("CL+CL", 9.0): (0, 20), ("CL+CL", 10.0): (0, 20)}
    make_sweep(folder / "los", "los", los)
    driven = {("CL+none", 8.0): (1, 3), ("CL+CL", 8.0): (0, 3)}
    make_sweep(folder / "model", "model", driven, {"CL+none": {"first_detection_m": 6.5}, "CL+CL": SENT})
    for combo in ("CL+none", "CL+CL"):
        make_video(folder / "model" / "videos" / f"t_junction_model_{combo}_8_0.mp4")
    return place


def make_benchmark(place):
    rows = []
    for combo in SENSOR_SETS:
        car, pedestrian = AP[combo]
        row = {"combo": combo, "region": "camera_fov"}
        row |= {"Car": {"overall": {"0.7": car, "0.01": 99.0}}, "Pedestrian": {"overall": {"0.3": pedestrian}}}
        sent = {
            "camera": None if combo.endswith("none") else 5600.0,
            "lidar": 6100.0 if combo.endswith("+CL") else None,
        }
        rows.append(row | {"bytes_per_map": sent})
    other = [row | {"region": "full_range", "Car": {"overall": {"0.7": 1.0}}} for row in rows]
    write(
        place.out / "benchmark.json", {"meta": META | {"command": "python t.py", "split": "test"}, "rows": rows + other}
    )
    place.table_file.parent.mkdir(parents=True)
    table = ["Benchmark, region camera_fov", "", "| vehicle | Car |", "| - | - |", "| C | 1.0/2.0 |", ""]
    gains = ["Gain of the roadside:", "", "- CL+CL, Car 0.7: +11.5 [+8.1, +13.8] over 12 scenes", "- C+C, Car 0.7: -"]
    place.table_file.write_text("\n".join(table + gains))


def make_bandwidth(folder):
    def point(study, label, sent, car, gain=None):
        ap = {"camera_fov": {"Car": {"overall": {"0.7": car}}, "Pedestrian": {"overall": {"0.3": car - 5}}}}
        gains = {"points": gain, "low": -4.0, "high": 0.5} if gain is not None else None
        row = {"study": study, "label": label, "combo": "CL+CL", "ap": ap, "bytes_per_frame": sent}
        return row | {"gain": {"Car": gains, "Pedestrian": gains}}

    def size(modality, median):
        row = {"study": "reference", "label": "float16, as trained", "modality": modality, "median": median}
        return row | {"p95": median + 100, "blocks": 3.0, "mbit_per_s": 0.9}

    rows = [point("reference", "vehicle alone", 0.0, 71.0), point("reference", "float16, as trained", 11700.0, 82.5)]
    rows.append(point("loss", "20 % lost", 11700.0, 80.0, -2.5))
    maps = [size("camera", 5651.0), size("lidar", 6049.0)]
    meta = META | {"command": "python b.py", "split": "test"}
    write(
        folder / "bandwidth.json", {"config": "cp_small", "meta": meta, "combos": ["CL+CL"], "maps": maps, "rows": rows}
    )
    write_picture(folder / "ap_loss.png", np.full((100, 300, 3), 250, np.uint8))
    (folder / "report.md").write_text(
        "# Bytes\n\n## Sizes\n\n| a | b |\n| - | - |\n| 1 | 2 |\n\n![loss](ap_loss.png)\n"
    )


def make_sweep(folder, perception, cells, values=None):
    """``cells``: (combination, speed) -> (crashes, trials); ``values``: combination -> columns that differ."""
    rows, counted = [], []
    for (combo, speed), (crashes, trials) in cells.items():
        key = {"scenario": "t_junction", "perception": perception, "combo": combo, "speed": speed}
        counted.append(key | {"crashes": crashes, "trials": trials})
        for trial in range(trials):
            ending = {"outcome": "front", "impact_speed_mps": 3.2} if trial < crashes else {"outcome": "none"}
            rows.append(key | {"trial": trial} | EPISODE | (values or {}).get(combo, {}) | ending)
    write(folder / "summary.json", {"meta": META | {"command": f"python {perception}.py"}, "cells": counted})
    with (folder / "episodes.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    write_report(folder)


def make_video(file, seconds=2, fps=10):
    """A bar that moves, its poster and its stills."""

    def image(k):
        canvas = np.full((180, 320, 3), 40, np.uint8)
        cv2.rectangle(canvas, (10 * k, 60), (10 * k + 40, 120), (230, 120, 60), -1)
        return canvas

    written = write_video(file, (image(k) for k in range(seconds * fps)), fps)
    write_picture(written.with_name(f"{written.stem}_poster.jpg"), image(3))
    write_picture(written.with_name(f"{written.stem}_stills.jpg"), np.vstack([image(0), image(9)]))
    return written


def write(file, content):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content))
