"""A step runs its command, and ends the tour where it fails."""

import pytest

from pcdet_avp.errors import ConfigError
from pcdet_avp.tour.step import Step
from pcdet_avp.visualization.page import Table

TABLE = Table("c", ["| a |", "| - |"], "source `python x`")


def test_a_command_that_fails_ends_the_tour(capfd):
    step = Step("Title", "text", ["safety_eval", "--scenario", "none of ours", "--perception", "los"])
    with pytest.raises(
        ConfigError, match=r"ended at: python tools/safety_eval\.py --scenario 'none of ours'.* status 2"
    ):
        step.run()
    assert "none of ours" in capfd.readouterr().err


@pytest.mark.parametrize(("parts", "command"), [((), "python tools/test.py --x"), ((TABLE,), "")])
def test_the_command_stands_below_a_section_unless_a_table_names_it(parts, command):
    assert Step("T", "t", ["test", "--x"], lambda: parts).section().command == command
