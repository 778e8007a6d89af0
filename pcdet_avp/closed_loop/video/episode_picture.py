"""One moment of an episode as a picture: both cameras, the garage from above, speeds over time."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pcdet_avp.closed_loop.video.garage_plan import garage_plan, window_end_x, window_right_y
from pcdet_avp.sim.actors import box_at, stands
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.ego import EGO_FOOTPRINT
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose
from pcdet_avp.visualization.draw import BevCanvas, camera_panel, put_text
from pcdet_avp.visualization.palette import CLASS_COLORS, EGO_LIGHT, INFRA_LIGHT, TRUE_COLOR
from pcdet_avp.visualization.time_strip import TimeStrip

CAMERA_PX, MAP_PX, STRIP_PX = (576, 324), (864, 648), (1440, 162)  # width, height
WINDOW_M, BEHIND_M = 44.0, 8.0  # what the map shows: its width, how much of it behind the ego
MAP_SCALE = MAP_PX[0] / WINDOW_M  # pixels a metre
MAP_HEIGHT_M = MAP_PX[1] / MAP_SCALE
FUSED_COLOR, ALONE_COLOR, EGO_COLOR, MAST_COLOR = CLASS_COLORS["Pedestrian"], EGO_LIGHT, (245, 245, 245), INFRA_LIGHT
IGNORED_COLOR = (155, 104, 130)
SMALL_M = 1.5  # boxes smaller than this are ringed on the map, or nobody would see them
WINDSCREEN, WINDSCREEN_COLOR = np.array([[0.75, 0.0, 0.0, 0.7, 1.5, 1.0, 0.0]]), (70, 78, 90)  # tells front from rear
BANNERS = {"front": (200, 50, 50), "side": (200, 120, 40), "none": (60, 140, 75)}


@dataclass(frozen=True, eq=False)
class Moment:
    """What a picture shows. Boxes (N, 7) in the world frame; None: perception sleeps, or there is no roadside."""

    time_s: float
    ego: AgentView
    infra: AgentView
    users: np.ndarray  # every road user that moves or waits to
    fused: np.ndarray | None  # detections of the combination that drives, those that the policy heeds
    alone: np.ndarray | None  # ... of the same vehicle without the roadside
    ignored: np.ndarray  # other detections of the combination that drives: parked cars
    banner: tuple[str, str] | None = None  # text, outcome


@dataclass(frozen=True, eq=False)
class Background:
    """The garage from above at ``MAP_SCALE``, of which every picture shows a window around the ego.

    end_x: how far ahead the window goes at most; right_y: its lowest y (m, world).
    """

    plan: BevCanvas
    end_x: float
    right_y: float

    @classmethod
    def of(cls, scenario: Scenario) -> Background:
        """The scenario's garage with everybody who stands for good."""
        parked = np.array([box_at(actor, 0.0) for actor in scenario.actors if stands(actor)]).reshape(-1, 7)
        layout = scenario.layout
        plan = garage_plan(layout, parked, MAP_SCALE)
        return cls(plan, window_end_x(layout), window_right_y(layout, MAP_HEIGHT_M))

    def around(self, world_from_ego: Pose) -> BevCanvas:
        """The window around the ego; beyond the plan it is empty."""
        x_min = min(world_from_ego.translation[0] - BEHIND_M, self.end_x - WINDOW_M)
        window = BevCanvas(x_min, self.right_y, x_min + WINDOW_M, self.right_y + MAP_HEIGHT_M, MAP_SCALE)
        left, top = self.plan.pixels(np.array([window.x_min_m, window.y_max_m])).round().astype(int)
        height, width = self.plan.image.shape[:2]
        rows = slice(max(top, 0), max(min(top + MAP_PX[1], height), 0))
        columns = slice(max(left, 0), max(min(left + MAP_PX[0], width), 0))
        part = self.plan.image[rows, columns]
        if part.size:
            down, right = rows.start - top, columns.start - left
            window.image[down : down + part.shape[0], right : right + part.shape[1]] = part
        return window


class EpisodePainter:
    """Paints the moments of one episode."""

    def __init__(self, background: Background, strip: TimeStrip, title: str, uses_infra: bool) -> None:
        self._background, self._strip, self._title, self._uses_infra = background, strip, title, uses_infra

    def picture(self, moment: Moment) -> np.ndarray:
        """(810, 1440, 3) uint8 RGB."""
        right = np.vstack([self._camera(moment, "ego"), self._camera(moment, "infra")])
        return np.vstack([np.hstack([right, self._map(moment)]), self._strip.at(moment.time_s)])

    def _camera(self, moment: Moment, agent: str) -> np.ndarray:
        view, found = getattr(moment, agent), moment.fused if moment.fused is not None else np.zeros((0, 7))
        used = agent == "ego" or self._uses_infra
        boxes, tints = [moment.users], [TRUE_COLOR] * len(moment.users)
        if used:
            boxes = [moment.ignored, *boxes, found]
            tints = [IGNORED_COLOR] * len(moment.ignored) + tints + [FUSED_COLOR] * len(found)
        to_agent = view.world_from_agent.inverse()
        name = {"ego": "vehicle camera", "infra": "roadside camera" + ("" if used else " (not used)")}[agent]
        name = name if view.image is not None else "no roadside camera"
        boxes = transform_boxes(to_agent, np.concatenate(boxes))
        panel = camera_panel(view, boxes, np.array(tints, np.uint8).reshape(-1, 3), name, CAMERA_PX[0])
        return panel if used else panel // 2

    def _map(self, moment: Moment) -> np.ndarray:
        canvas = self._background.around(moment.ego.world_from_agent)
        mast = moment.infra.world_from_agent
        if self._uses_infra:
            _wedge(canvas, mast, MAST_COLOR)
        _wedge(canvas, moment.ego.world_from_agent, EGO_LIGHT)
        fill_ego(canvas, moment.ego.world_from_agent)
        canvas.boxes(moment.ignored, np.array([IGNORED_COLOR] * len(moment.ignored), np.uint8).reshape(-1, 3), 1)
        for box in moment.users:
            canvas.fill(bev_corners(box[None])[0], TRUE_COLOR)
        if self._uses_infra:
            mark(canvas, moment.alone, ALONE_COLOR, 12, 2)
        mark(canvas, moment.fused, FUSED_COLOR, 8, 2)
        canvas.ring(mast.translation[:2], 7, MAST_COLOR, -1)
        self._labels(canvas.image, moment)
        return canvas.image

    def _labels(self, image: np.ndarray, moment: Moment) -> None:
        put_text(image, self._title, (12, 24), scale=0.55)
        put_text(image, f"t = {moment.time_s:.2f} s", (image.shape[1] - 130, 24), scale=0.55)
        entries = [("road users", TRUE_COLOR), ("detected", FUSED_COLOR)]
        if self._uses_infra:
            entries[1:] = [("detected with the roadside", FUSED_COLOR), ("detected by the car alone", ALONE_COLOR)]
        if len(moment.ignored):
            entries.append(("detected and ignored: parked, or past", IGNORED_COLOR))
        for row, (text, color) in enumerate(entries):
            y = image.shape[0] - 16 - 22 * (len(entries) - 1 - row)
            cv2.rectangle(image, (14, y - 10), (26, y + 2), color, -1)
            put_text(image, text, (36, y), scale=0.5)
        if moment.fused is None:
            put_text(image, "perception sleeps: nobody near", (12, 48), (150, 150, 150), 0.5)
        if moment.banner:
            show_banner(image, *moment.banner)


def fill_ego(canvas: BevCanvas, world_from_ego: Pose) -> None:
    """The ego vehicle with its windscreen."""
    for box, color in ((EGO_FOOTPRINT, EGO_COLOR), (WINDSCREEN, WINDSCREEN_COLOR)):
        canvas.fill(bev_corners(transform_boxes(world_from_ego, box))[0], color)


def _wedge(canvas: BevCanvas, world_from_agent: Pose, color, reach_m: float = 45.0) -> None:
    """The borders of a camera's 90 degrees, and a breath of light between them."""
    corners = world_from_agent.apply(np.array([[0.0, 0, 0], [reach_m, reach_m, 0], [reach_m, -reach_m, 0]]))[:, :2]
    lit = BevCanvas(canvas.x_min_m, canvas.y_min_m, canvas.x_max_m, canvas.y_max_m, canvas.px_per_m)
    lit.image = canvas.image.copy()
    lit.fill(corners, color)
    canvas.image = cv2.addWeighted(canvas.image, 0.93, lit.image, 0.07, 0)


def mark(canvas: BevCanvas, boxes: np.ndarray | None, color, radius_px: int, thickness: int) -> None:
    """Outlines of detections; small ones are ringed."""
    for box in boxes if boxes is not None else ():
        if max(box[3:5]) < SMALL_M:
            canvas.ring(box[:2], radius_px, color, thickness)
        else:
            grown = box + [0, 0, 0, 0.03 * radius_px, 0.03 * radius_px, 0, 0]
            canvas.boxes(grown[None], np.array([color], np.uint8), thickness)


def show_banner(image: np.ndarray, text: str, outcome: str) -> None:
    y = image.shape[0] // 2 + 90
    cv2.rectangle(image, (0, y - 30), (image.shape[1], y + 18), BANNERS[outcome], -1)
    put_text(image, text, (24, y + 2), (255, 255, 255), 0.9)
