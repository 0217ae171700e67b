"""A floor that a projector lights, under a rendered camera."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep


def driven(*overrides: str) -> Run:
    run = Lockstep(load_config(SHIPPED / "projector.yaml", ["run.duration_s=6", *overrides]))
    assert run.run() == ("completed", None)
    return Run(run.recording)


def pose_rms_m(run: Run) -> float:
    assert run.pose_errors is not None
    return float(np.sqrt((run.pose_errors[0] ** 2).mean()))


@pytest.mark.slow
def test_light_at_full_contrast_takes_no_tag_and_no_accuracy(tmp_path: Path) -> None:
    """With a checkerboard over the whole floor, which tags without discs would not bear."""
    cells = (255 * (np.indices((20, 32)).sum(axis=0) % 2)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "checkerboard.png"), np.repeat(np.repeat(cells, 60, axis=0), 60, axis=1))
    dark = driven("projectors=[]")
    lit = driven(f"projection.background={tmp_path}/checkerboard.png")
    assert lit.items["measured"].all()
    assert pose_rms_m(lit) <= 1.1 * pose_rms_m(dark)
