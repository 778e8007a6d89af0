"""Labels and frames: difficulty by visible vertices, selection, and what is refused."""

import numpy as np
import pytest

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.frame import DIFFICULTIES, AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose


def labels(n=9, **changes):
    boxes = np.tile([10.0, 0, 0.75, 4, 2, 1.5, 0], (n, 1))
    fields = {
        "boxes": boxes,
        "names": np.array(["Car", "Pedestrian"] * n)[:n],
        "object_ids": np.arange(n),
        "visible_vertices": np.arange(n) % 9,
        "hit_counts": np.zeros((n, 4), int),
    }
    return Labels(**(fields | changes))


def test_difficulty_by_the_number_of_visible_vertices():
    """invisible 0-1, hard 2-4, easy 5-8."""
    assert [DIFFICULTIES[d] for d in labels().difficulty] == ["invisible"] * 2 + ["hard"] * 3 + ["easy"] * 4


def test_selection_keeps_rows_together():
    chosen = labels().select(np.array([False, True, False, False, False, True, False, False, False]))
    assert chosen.object_ids.tolist() == [1, 5]
    assert chosen.visible_vertices.tolist() == [1, 5]
    assert chosen.names.tolist() == ["Pedestrian", "Pedestrian"]


def test_no_labels_are_labels():
    none = Labels.empty()
    assert len(none) == 0
    assert none.difficulty.shape == (0,)
    assert len(labels().select(np.zeros(9, bool))) == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": np.array(["Car"])}, "labels.names: expected 9 rows, found 1"),
        ({"hit_counts": np.zeros((9, 3), int)}, r"labels.hit_counts: expected shape \(9, 4\)"),
        ({"names": np.array(["Truck"] * 9)}, "unknown classes.*Truck.*Car"),
        ({"boxes": np.zeros((9, 7))}, "labels.boxes.*positive"),
    ],
)
def test_labels_that_do_not_fit_together_are_refused(changes, message):
    with pytest.raises(GeometryError, match=message):
        labels(**changes)


def test_ego_from_infra_maps_what_both_agents_see_onto_each_other():
    """A pillar 8 m ahead of the mast, which looks back along the road, stands 12 m ahead of a car 20 m away."""
    mast = AgentView(Pose.from_xyz_yaw(0, 0, 0, yaw=np.pi))
    car = AgentView(Pose.from_xyz_yaw(-20, -1.7, 0, yaw=0.0))
    frame = Frame("a/0", 0.0, car, mast)
    np.testing.assert_allclose(frame.ego_from_infra.apply(np.array([8.0, 1, 2])), [12, 0.7, 2], atol=1e-9)
    assert abs(frame.ego_from_infra.yaw) == pytest.approx(np.pi)
    assert len(frame.labels) == 0
