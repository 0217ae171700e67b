"""Files of settings with mistakes in them are refused in the project's own words, or accepted; nothing else."""

from pathlib import Path

import pytest

from tools.measure.runs.mutated import attack


def _hold(folder: Path, files: int, patch: pytest.MonkeyPatch) -> None:
    patch.setenv("XDG_CONFIG_HOME", str(folder))
    figures = attack(folder, files, 1)
    assert figures.others == {}
    assert figures.refused.total() + figures.accepted.total() == files
    assert figures.refused.total() > files / 2


@pytest.mark.slow
def test_mutated_settings_are_refused_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _hold(tmp_path, 100, monkeypatch)


@pytest.mark.long
def test_two_thousand_mutated_settings_are_refused_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _hold(tmp_path, 2000, monkeypatch)
