"""An imported recording in the tools: what the network finds in it is what it finds in the recording's source."""

import json
from dataclasses import replace

import pytest
from datasets.importers.written import mounts_of, write_carla

from pcdet_avp.datasets.avp.manifest import Scene, read_manifest, write_manifest
from pcdet_avp.datasets.avp.record import read_frame, write_frame
from pcdet_avp.datasets.importers.run import import_recording, open_recording


@pytest.mark.slow
def test_an_imported_recording_is_tested_as_its_source_is(call, trained, tiny_data, tmp_path):
    """Through CARLA's layout and back. How visible an object is was lost on the way, so only "overall" is compared."""
    manifest = read_manifest(tiny_data)
    frames = [read_frame(tiny_data, scene.frame_ids[0]) for scene in manifest.scenes]
    write_carla(tmp_path / "carla" / "s", frames, mounts_of(frames))
    import_recording(open_recording("carla", tmp_path / "carla"), "carla", tmp_path / "set", splits={"s": "test"})
    for number, frame in enumerate(frames):
        write_frame(tmp_path / "source", replace(frame, frame_id=f"s/{412 + number}"))
    scene = Scene("s", "test", tuple(str(412 + number) for number in range(len(frames))))
    write_manifest(tmp_path / "source", replace(manifest, scenes=(scene,), complete=True))
    ckpt, rows = trained / "ckpt" / "checkpoint_epoch_2.pth", {}
    for name in ("set", "source"):
        call(tmp_path, "test", "--ckpt", ckpt, "--json", tmp_path / f"{name}.json", data=tmp_path / name)
        rows[name] = json.loads((tmp_path / f"{name}.json").read_text())["rows"]
    assert len(rows["set"]) == len(rows["source"]) == 12
    assert max(row["Car"]["overall"]["0.01"] for row in rows["source"]) > 0  # or the comparison would say nothing
    for ours, theirs in zip(rows["set"], rows["source"], strict=True):
        assert (ours["combo"], ours["region"]) == (theirs["combo"], theirs["region"])
        for name, iou in (("Car", "0.01"), ("Pedestrian", "0.01")):
            assert ours[name]["overall"][iou] == pytest.approx(theirs[name]["overall"][iou], abs=0.5)
