"""Joined tables are what concatenation gives, whatever was in the room before."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.sim.rays.face_tables import FaceRoom


def scene(rng, faces):
    return SimpleNamespace(colors=rng.random((faces, 3), np.float32))


@pytest.mark.parametrize("sizes", [[(7, 2)], [(7, 2), (7, 5)], [(7, 2), (7, 40)], [(7, 2), (9, 2), (7, 2)], [(), (3,)]])
def test_a_room_joins_one_set_of_scenes_after_another(sizes):
    rng, room = np.random.default_rng(0), FaceRoom()
    first = {faces: scene(rng, faces) for faces in (3, 7, 9)}
    for start, *rest in filter(None, [*sizes, *sizes]):
        scenes = [first[start], *(scene(rng, faces) for faces in rest)]
        joined = room.joined("colors", scenes, (3,), np.float32)
        np.testing.assert_array_equal(joined, np.concatenate([s.colors for s in scenes]))


def test_no_scene_has_an_empty_table():
    assert FaceRoom().joined("colors", [], (3,), np.float32).shape == (0, 3)


def test_what_stays_is_copied_once():
    rng, room = np.random.default_rng(0), FaceRoom()
    still = scene(rng, 100)
    before = room.joined("colors", [still, scene(rng, 5)], (3,), np.float32)
    before[:100] = -1.0  # nobody puts them right again
    after = room.joined("colors", [still, scene(rng, 6)], (3,), np.float32)
    assert np.shares_memory(before, after)
    assert (after[:100] == -1.0).all()
