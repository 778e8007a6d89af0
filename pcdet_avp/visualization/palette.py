"""The colours of every picture and plot, so that a class or a sensor looks the same wherever it is shown.

``_COLORS`` are RGB triples (0 to 255) for dark pictures; ``_INKS`` are for plots on white paper, in the same hues.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

CLASS_COLORS: Mapping[str, tuple[int, int, int]] = {"Car": (255, 175, 50), "Pedestrian": (255, 90, 170)}
CLASS_INKS: Mapping[str, str] = {"Car": "#b36b00", "Pedestrian": "#c2186e"}
OTHER_COLOR, TRUE_COLOR, EGO_COLOR = (120, 200, 255), (70, 190, 90), (255, 255, 255)
DIFFICULTY_COLORS = np.array([[90, 220, 110], [250, 190, 60], [240, 80, 80]], np.uint8)  # easy, hard, invisible

EGO_LIGHT, INFRA_LIGHT = (90, 170, 255), (255, 150, 60)  # the agents' point clouds
MODALITY_INKS: Mapping[str, str] = {"camera": "#1f77b4", "lidar": "#d95f02"}
INFRA_INKS: Mapping[str, str] = {"none": "#6e6e6e", "C": "#e08a00", "CL": "#0062a8"}  # told apart by the colour-blind
