"""Names find their classes; a wrong or doubled name says which names there are."""

import pytest

from pcdet_avp import registry
from pcdet_avp.errors import RegistryError
from pcdet_avp.registry import Registry


def test_a_registered_class_is_found_under_its_name():
    table = Registry("MODEL.FUSER.NAME")

    @table.register("MaxFusion")
    class MaxFusion:
        pass

    assert table["MaxFusion"] is MaxFusion
    assert dict(table) == {"MaxFusion": MaxFusion}


def test_an_unknown_name_raises_and_lists_the_known_ones():
    table = Registry("MODEL.FUSER.NAME")
    table.register("Max")(int)
    table.register("Average")(float)
    with pytest.raises(RegistryError, match=r"MODEL.FUSER.NAME: unknown name 'Mx'; known: Average, Max"):
        table["Mx"]


def test_a_name_cannot_be_taken_twice():
    table = Registry("MODEL.FUSER.NAME")
    table.register("Max")(int)
    with pytest.raises(RegistryError, match=r"'Max' is already registered as builtins.int.*float"):
        table.register("Max")(float)
    assert table["Max"] is int


def test_a_name_that_is_no_string_is_unknown_not_a_crash():
    with pytest.raises(RegistryError, match="unknown name"):
        Registry("MODEL.NAME")[["a", "list"]]


def test_every_table_is_a_registry_with_its_own_key():
    tables = [value for value in vars(registry).values() if isinstance(value, Registry)]
    assert len({table.key for table in tables}) == len(tables) == 8
