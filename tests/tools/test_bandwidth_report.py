"""tools/bandwidth_report.py as a user meets it."""

import json
import logging
from pathlib import Path

import pytest

from pcdet_avp.errors import ConfigError

PLOTS = {"bytes.png", "ap_bytes.png", "ap_loss.png", "age.png"}


@pytest.fixture(scope="module")
def report(load_tool, call, trained, tmp_path_factory):
    """A folder with the report of two studies; the tool was run twice, the second time from finished frames."""
    folder, ckpt = tmp_path_factory.mktemp("report"), trained / "ckpt" / "checkpoint_epoch_2.pth"
    how = ("--ckpt", ckpt, "--out", folder / "out", "--combos", "CL+CL", "--studies", "loss,objects")
    call(folder, "bandwidth_report", *how)
    first = (folder / "out" / "bandwidth.json").read_text()
    (folder / "out" / "bandwidth.json").unlink()
    call(folder, "bandwidth_report", *how)
    return folder / "out", json.loads(first)


def test_every_row_has_its_numbers(report):
    _, content = report
    labels = [row["label"] for row in content["rows"]]
    assert labels[:2] == ["vehicle alone", "float16, as trained"]
    assert "20 % lost" in labels
    assert labels[-1] == "boxes (late fusion)"
    for row in content["rows"]:
        assert set(row["ap"]) == {"camera_fov", "full_range"}
        uncoded = row["label"] == "boxes, not quantised"
        assert row["bytes_per_frame"] is None if uncoded else row["bytes_per_frame"] >= 0
    assert content["meta"]["budget_bytes"] == 1125
    assert content["meta"]["config"] == "cp_tiny"
    assert next(row for row in content["rows"] if row["label"] == "100 % lost")["same_as_alone"]


def test_late_fusion_is_judged_before_and_after_its_message(report):
    folder, content = report
    assert [(row["combo"], row["class"]) for row in content["quantisation"]] == [
        ("CL+CL", "Car"),
        ("CL+CL", "Pedestrian"),
    ]
    by_label = {row["label"]: next(iter(row["ap"].values())) for row in content["rows"]}
    for row, overlap in zip(content["quantisation"], ("0.7", "0.3"), strict=True):
        before, after = (
            by_label[x][row["class"]]["overall"][overlap] for x in ("boxes, not quantised", "boxes (late fusion)")
        )
        assert (row["before"], row["after"]) == (before, after)
        if row["gain"] is not None:
            assert row["gain"]["points"] == pytest.approx(after - before)
            assert row["gain"]["low"] <= row["gain"]["high"]
    assert "before quantisation" in (folder / "report.md").read_text()


def test_messages_have_the_bytes_of_the_formula(report):
    folder, content = report
    message = content["message"]
    assert not message["encoded"]
    cars = {row["objects"]: (row["formula"], row["formula_without_velocity"]) for row in message["cars"]}
    assert list(cars) == list(range(1, 65))
    assert cars[1] == (65, 59)
    assert cars[64] == (2090, 1722)
    (late,) = (row for row in content["rows"] if row["label"] == "boxes (late fusion)")
    assert late["bytes_per_frame"] == message["all_boxes"]["mean"] > message["all_boxes"]["without_velocity"]["mean"]
    assert "Object-level message" in (folder / "report.md").read_text()


def test_messages_are_encoded_for_real(report, call, trained, tmp_path):
    """With an ASN.1 text of our own: the same bytes, counted, and the folder is read before the work."""
    pytest.importorskip("asn1tools", reason="asn1tools is not installed (extra 'cpm')")
    _, content = report
    ckpt, asn1 = trained / "ckpt" / "checkpoint_epoch_2.pth", Path(__file__).parents[1] / "link" / "asn1"
    how = ("--ckpt", ckpt, "--out", tmp_path / "out", "--combos", "CL+CL", "--studies", "objects")
    call(tmp_path, "bandwidth_report", *how, "--cpm_asn1", asn1)
    encoded = json.loads((tmp_path / "out" / "bandwidth.json").read_text())["message"]
    assert encoded["encoded"]
    assert encoded["all_boxes"] == content["message"]["all_boxes"]
    assert all(row["encoded"] == row["formula"] for row in encoded["cars"])
    assert all(row["encoded_without_velocity"] == row["formula_without_velocity"] for row in encoded["cars"])
    assert "differ by at most 0 B" in (tmp_path / "out" / "report.md").read_text()
    with pytest.raises(ConfigError, match="module CPM-PDU-Descriptions, found none"):
        call(tmp_path, "bandwidth_report", *how, "--cpm_asn1", trained)


def test_a_second_run_only_reads(report):
    folder, content = report
    again = json.loads((folder / "bandwidth.json").read_text())
    assert {**again, "meta": None} == {**content, "meta": None}
    assert any("1 of 1 frames are done" in log.read_text() for log in folder.glob("*.log"))


def test_every_title_names_the_configuration(report):
    folder, _ = report
    text = (folder / "report.md").read_text()
    titles = [line for line in text.splitlines() if line.startswith("#")]
    assert all("cp_tiny" in line for line in titles if "compared" not in line)
    assert {file.name for file in folder.iterdir()} >= PLOTS
    assert not list(folder.glob("*.tmp"))


def test_what_makes_no_sense_is_refused(call, trained, tmp_path):
    ckpt = trained / "ckpt" / "checkpoint_epoch_2.pth"
    with pytest.raises(ConfigError, match="no roadside"):
        call(tmp_path, "bandwidth_report", "--ckpt", ckpt, "--combos", "C+none")
    with pytest.raises(ConfigError, match=r"--studies: expected some of .*, found rain"):
        call(tmp_path, "bandwidth_report", "--ckpt", ckpt, "--studies", "rain")


def test_a_plot_that_fails_takes_no_numbers_along_and_is_named(report, tmp_path, monkeypatch, caplog):
    from pcdet_avp.bandwidth import plots
    from pcdet_avp.bandwidth.report import write_report

    def broken(content):
        raise ZeroDivisionError("no labels at all")

    monkeypatch.setattr(plots, "bytes_histogram", broken)
    write_report(report[1], tmp_path, logging.getLogger("test"))
    assert json.loads((tmp_path / "bandwidth.json").read_text()) == report[1]
    text = (tmp_path / "report.md").read_text()
    assert "(bytes.png)" not in text
    assert "(ap_bytes.png)" in text
    assert "bytes.png: this plot could not be drawn (ZeroDivisionError: no labels at all)" in caplog.text
