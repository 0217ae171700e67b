"""Folders that are handed to a process for its modules: what is no list of them is refused in a line."""

import pytest

from robofleet.core.plugins import PluginError, load


@pytest.mark.parametrize("folders", ["/lab", "{}", "[1]", ""])
def test_folders_that_are_no_list_are_refused_in_a_line(folders: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOFLEET_MODULES", folders)
    with pytest.raises(PluginError, match=r"^ROBOFLEET_MODULES of the environment is no list of folders, .*unset it$"):
        load("robofleet.drivers", "nothing_here:Driver")
