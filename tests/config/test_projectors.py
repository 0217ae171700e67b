"""Projectors of a configuration that cannot be."""

import pytest

from robofleet.config.load import ConfigError, load_config, spelled
from tests.projection.projectors import SIZE, tilted
from tests.shipped import PLATOON

MAIN = {"name": "main", "width": SIZE[0], "height": SIZE[1]}
MODEL = tilted().model.model_dump(mode="json")
SIMULATED = MAIN | {"simulated": {"model": MODEL}}


@pytest.mark.parametrize(
    ("projectors", "changes", "fault"),
    [
        ([MAIN, MAIN], [], "projectors.1.name: main is projectors.0's already: give each its own name"),
        (
            [MAIN | {"width": 1920, "calibration": MODEL}], [],
            "projectors.0.calibration: is for pictures of 960 x 540 px, not 1920 x 540: mend one, or calibrate again",
        ),
        ([SIMULATED], ["camera.source=mujoco"], "camera.source: 'mujoco' shows no light of projectors.0"),
        ([MAIN | {"calibration": "main"}], [], "projectors.0.calibration: there is no file .*projectors/main.yaml"),
    ],
    ids=["names", "size", "mujoco", "file"],
)  # fmt: skip
def test_it_is_refused(projectors: list[object], changes: list[str], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        load_config(PLATOON, [f"projectors={spelled(projectors)}", *changes])
