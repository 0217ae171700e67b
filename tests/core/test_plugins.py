"""Folders that are handed to a process for its modules: what is no list of them is refused in a line."""

from pathlib import Path

import pytest

from robofleet.core.plugins import PluginError, load


@pytest.mark.parametrize("folders", ["/lab", "{}", "[1]", ""])
def test_folders_that_are_no_list_are_refused_in_a_line(folders: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOFLEET_MODULES", folders)
    with pytest.raises(PluginError, match=r"^ROBOFLEET_MODULES of the environment is no list of folders, .*unset it$"):
        load("robofleet.drivers", "nothing_here:Driver")


def test_a_module_that_imports_what_has_moved_is_told_where_to_import_it_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "of_yesterday.py").write_text("\nfrom robofleet.comms.messages import TagPose\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match=r"mend line 2 of .*of_yesterday\.py: import it from `robofleet` itself"):
        load("robofleet.poses", "of_yesterday:Poses")


def test_an_entry_point_of_before_a_move_says_to_install_its_package_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old-1.0.dist-info").mkdir()
    points = "[robofleet.tests_plugins]\nold = robofleet.no_more:Camera\n"
    (tmp_path / "old-1.0.dist-info" / "entry_points.txt").write_text(points)
    (tmp_path / "old-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: old\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match=r"No module named 'robofleet.no_more': install its package again"):
        load("robofleet.tests_plugins", "old")
