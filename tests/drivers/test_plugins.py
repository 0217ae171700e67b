"""Drivers and cameras are found by name."""

from collections import OrderedDict

import pytest

from robofleet.core.plugins import PluginError, load
from robofleet.drivers.simulated import SimulatedRobot


def test_an_entry_point_is_found() -> None:
    assert load("robofleet.drivers", "simulated") is SimulatedRobot


def test_a_class_is_found_without_being_installed() -> None:
    assert load("robofleet.drivers", "collections:OrderedDict") is OrderedDict


def test_an_unknown_name_says_which_there_are() -> None:
    with pytest.raises(PluginError, match=r"there is no driver 'gternel': did you mean 'gternal'\?"):
        load("robofleet.drivers", "gternel")
    with pytest.raises(PluginError, match="none: install robofleet"):
        load("robofleet.nothing", "simulated")


@pytest.mark.parametrize(
    "name",
    ["no_such_module:Robot", "collections:NoSuchClass", "collections:", ":Robot", ".here:Robot", "not a module:X"],
)
def test_what_cannot_be_loaded_is_one_clear_error(name: str) -> None:
    with pytest.raises(PluginError, match="cannot be loaded"):
        load("robofleet.drivers", name)
