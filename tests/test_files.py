"""Files are whole, or not there at all."""

import json
import os
from pathlib import Path

import pytest

from pcdet_avp.errors import OutputError
from pcdet_avp.files import check_writable, flat_name, make_folder, unlike_names, write_bytes, write_json


def test_json_is_whole_or_absent(tmp_path):
    with pytest.raises(ValueError, match="Out of range"):
        write_json(tmp_path / "a.json", {"ap": float("nan")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "b" / "a.json", {"ap": 1.5})
    assert json.loads((tmp_path / "b" / "a.json").read_text()) == {"ap": 1.5}


def test_what_cannot_be_moved_into_place_leaves_the_old_file(tmp_path, monkeypatch):
    write_bytes(tmp_path / "a", b"old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OutputError, match=r"a: cannot be written .No space left"):
        write_bytes(tmp_path / "a", b"new")
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("a", b"old")]


def test_a_place_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file/run: cannot be written"):
        write_bytes(tmp_path / "file" / "run", b"")


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file.* cannot make this folder"):
        make_folder(tmp_path / "file" / "run")


def test_a_file_that_cannot_be_written_is_named_before_the_work_for_it(tmp_path):
    check_writable(tmp_path / "new" / "result.json")
    assert not list((tmp_path / "new").iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"new: cannot write this file \(Is a directory\)"):
        check_writable(tmp_path / "new")
    with pytest.raises(OutputError, match="cannot make this folder"):
        check_writable(tmp_path / "file" / "result.json")


def test_flat_names_of_records_stay_and_no_two_ids_share_one():
    assert flat_name("scene_0000/000000") == "scene_0000_000000"
    parts = ["lot", "lot_a", "a", "1", "a_1", "_", "a@1", "a%401", "@", "%40", "a_", "_a", "a__1"]
    ids = [f"{scene}/{frame}" for scene in parts for frame in parts]
    assert len({flat_name(frame_id) for frame_id in ids}) == len(ids)
    assert not any("/" in flat_name(frame_id) for frame_id in ids)


def test_files_of_one_stem_keep_names_of_their_own():
    names = ["a.bin", "a.npy", "a.bin.bin", "b.pcd", "B.ply", "c.bin", "a.bin_2.bin", "a.npy.bin"]
    found = unlike_names([Path(name) for name in names])
    assert len({name.lower() for name in found}) == len(names)
    assert found[5] == "c"
