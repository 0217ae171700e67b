"""``robofleet calibrate projector``, with simulated cameras and a simulated projector."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration.store import load
from robofleet.config.load import resolved_yaml
from robofleet.config.projectors import ProjectorModel
from robofleet.projection.model import Projector
from tests.projection.projectors import pixels
from tests.simulation.test_projector import TRUTH, config


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    tree = yaml.safe_load(resolved_yaml(config()))
    tree["arena"]["size_m"] = [2.8, 1.6]
    (tmp_path / "lab.yaml").write_text(yaml.safe_dump(tree))
    return tmp_path / "lab.yaml"


def calibrate(file: Path, *options: str) -> Result:
    return CliRunner().invoke(cli.app, ["calibrate", "projector", str(file), "--report", "report.html", *options])


@pytest.mark.slow
def test_a_projector_is_calibrated_and_verified_and_a_bad_one_replaces_nothing(file: Path) -> None:
    done = calibrate(file)
    assert done.exit_code == 0, done.output
    assert "write `calibration: main` to the projector main" in done.output
    written = file.parent / "projectors" / "main.yaml"
    model = load(written, ProjectorModel)
    off = Projector.from_model(model).floor(pixels()) - TRUTH.floor(pixels())
    assert np.linalg.norm(off, axis=1).max() < 1e-3
    assert model.delay_s == pytest.approx(0.05, abs=0.02)
    assert "Where the light of main falls" in (file.parent / "report.html").read_text()
    still = calibrate(file, "--verify", "--set", "projectors.0.calibration=main", "--set", "projectors.0.disc_gray=0.9")
    assert still.exit_code == 0, still.output
    assert "disc_gray 0.9 may be too bright for overhead: lower it to 0." in still.output
    before = written.read_bytes()
    refused = calibrate(file, "--set", "arena.size_m=[5.6, 1.6]")
    assert refused.exit_code == 2
    assert written.read_bytes() == before


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--projector", "mian"], "--projector: there is no projector 'mian': did you mean 'main'?"),
        (["--verify"], "projector main: it is not calibrated: run robofleet calibrate projector"),
        (["--set", "projectors=[]"], "lab.yaml: it has no projector"),
        (
            ["--set", "projectors.0.simulated=null", "--set", "projectors.0.port=18420", "--wait-s", "0"],
            "projector main: no browser has opened http://127.0.0.1:18420/",
        ),
    ],
    ids=["name", "verify", "none", "away"],
)
def test_bad_input_is_refused_in_a_line(
    file: Path, options: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = calibrate(file, *options)
    assert refused.exit_code == 2
    assert line in refused.output
    assert not (file.parent / "projectors").exists()
