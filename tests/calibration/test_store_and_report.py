"""Calibrations on disk: whole or not at all, the earlier ones kept; and a page that stands alone."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from robofleet.calibration.report import Report
from robofleet.calibration.store import CalibrationError, load, provenance, save
from robofleet.config.calibrated import CameraModel


def camera(focal_px: float) -> CameraModel:
    return CameraModel(
        width=80,
        height=60,
        focal_px=(focal_px, focal_px),
        centre_px=(39.5, 29.5),
        distortion=(1e-7, -0.25, 0.0, 0.0, 1e3),
        intrinsics=provenance("intrinsics", {"a.png": b"a"}, {"rms_px": 0.25, "unknown": None}, ("f",), [[1e-9]]),
    )


def test_what_is_saved_is_loaded_and_every_earlier_one_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "new" / "folder" / "ceiling.yaml"
    models = [camera(focal) for focal in (100.0, 101.0, 102.0, 103.0)]
    kept = [save(file, model) for model in models]
    assert load(file, CameraModel) == models[-1]
    assert kept[0] is None
    assert [load(old, CameraModel) for old in kept[1:] if old is not None] == models[:-1]  # in one second, too
    assert sorted(path.name for path in file.parent.iterdir()) == ["ceiling.yaml", "earlier"]


@pytest.mark.slow
@settings(deadline=None, max_examples=40)
@given(st.floats(1.0, 1e6), st.lists(st.floats(-1e6, 1e6), min_size=5, max_size=5), st.text(max_size=20))
def test_any_calibration_comes_back_as_it_was(
    tmp_path_factory: pytest.TempPathFactory, focal: float, distortion: list[float], name: str
) -> None:
    model = camera(focal).model_copy(update={"distortion": tuple(distortion), "camera": name})
    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.unlink(missing_ok=True)
    save(file, model)
    assert load(file, CameraModel) == model


def test_a_folder_that_refuses_leaves_the_earlier_one_in_place(tmp_path: Path) -> None:
    file, before = tmp_path / "ceiling.yaml", camera(100.0)
    save(file, before)
    (tmp_path / "earlier").write_text("a file where the folder of the earlier ones would be")
    with pytest.raises(CalibrationError, match=r"ceiling\.yaml: cannot be written"):
        save(file, camera(101.0))
    assert load(file, CameraModel) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ceiling.yaml", "earlier"]
    with pytest.raises(CalibrationError, match="cannot be written"):
        Report("page").write(tmp_path / "earlier" / "page.html")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"a: [", "is not YAML"),
        (b"\xff\xfe", "is not UTF-8 text"),
        (b"width: 80", "height: is missing"),
        (b"[1, 2]", "must be a mapping"),
        (b"{width: 80, height: 60, focal_px: [-1.0, 1.0], centre_px: [0.0, 0.0], distortion: []}", "focal_px.0"),
        (b"{width: 80, height: 60, focal_px: [.nan, 1.0], centre_px: [0.0, 0.0], distortion: []}", "focal_px.0"),
    ],
)
def test_a_file_that_is_no_calibration(text: bytes, words: str, tmp_path: Path) -> None:
    file = tmp_path / "ceiling.yaml"
    file.write_bytes(text)
    with pytest.raises(CalibrationError) as refused:
        load(file, CameraModel)
    assert any(words in fault and str(file) in fault for fault in refused.value.faults)


def test_a_page_says_what_it_is_told_and_stands_alone(tmp_path: Path) -> None:
    report = Report("Lens <script>")
    report.verdict("bad & worse", good=False)
    report.section("Figures", "a < b")
    report.table(("name", "value"), [("x<y", 0.123456), ("none", None), ("count", 7)])
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot(np.arange(3))
    report.figure(figure, "three > two")
    file = tmp_path / "deep" / "page.html"
    report.write(file)
    page = file.read_text()
    for shown in ("Lens &lt;script&gt;", "bad &amp; worse", "a &lt; b", "x&lt;y", "0.1235", "<td>-</td>", "<td>7</td>"):
        assert shown in page
    assert "<script" not in page and "<svg" in page and "<?xml" not in page
    assert not re.search(r'(src|href)="(?!#)', page)
