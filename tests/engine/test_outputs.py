"""Where a run's files lie, and who writes the log."""

import pytest
import yaml
from easydict import EasyDict

from pcdet_avp.engine.outputs import RunFolder, open_log
from pcdet_avp.errors import OutputError


@pytest.mark.parametrize(
    ("cfg", "folder"),
    [
        ("cfgs/avp/cp_small.yaml", "output/avp/cp_small/t"),
        ("/home/me/cfgs/avp/ablations/no_attention.yaml", "output/avp/ablations/no_attention/t"),
        ("/cfgs/x/cfgs/avp/cp_small.yaml", "output/avp/cp_small/t"),
        ("/home/me/mine/net.yaml", "output/mine/net/t"),
    ],
)
def test_the_folder_follows_from_the_configuration_not_from_where_it_is(cfg, folder):
    assert RunFolder.of(cfg, "t").root.as_posix() == folder


def test_the_resolved_configuration_is_written_as_plain_yaml(tmp_path):
    RunFolder(tmp_path).write_config(EasyDict({"A": {"B": [1, {"C": 2.5}]}}), "net")
    assert yaml.safe_load((tmp_path / "net.yaml").read_text()) == {"A": {"B": [1, {"C": 2.5}]}}


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file.* cannot make this folder"):
        RunFolder(tmp_path / "file" / "run").create()


def test_only_the_first_rank_speaks_and_quiet_records_go_to_the_file_alone(tmp_path, capsys):
    logger = open_log(tmp_path, "train")
    logger.info("aloud")
    logger.info("aside", extra={"quiet": True})
    open_log(tmp_path, "train", first=False).info("from another rank")
    assert capsys.readouterr().err == "aloud\n"
    (file,) = tmp_path.glob("train_*.log")
    assert [line.split(" ", 2)[2] for line in file.read_text().splitlines()] == ["INFO aloud", "INFO aside"]
