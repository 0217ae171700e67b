"""`robofleet calibrate intrinsics`: what it writes, what it refuses with which words, and what the operator sees."""

import io
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from click.testing import Result
from rich.console import Console
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration.lens.board import Board
from robofleet.calibration.lens.floor import Ceiling
from robofleet.calibration.lens.gathering import Gathering, gather
from robofleet.calibration.lens.intrinsics import Conditions, measure
from robofleet.calibration.lens.live import picture
from robofleet.calibration.lens.views import Offer
from robofleet.calibration.store import load, save
from robofleet.config.calibrated import CameraModel, PoseSettings
from robofleet.config.load import load_config

from .conftest import TrueCamera

ROOT = Path(__file__).parents[3]
Calibrate = Callable[..., Result]


@pytest.fixture(scope="module")
def photos(true_camera: TrueCamera, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of 22 good views, one of them moved while a shutter rolled, and a view of no board."""
    folder, rng = tmp_path_factory.mktemp("photos"), np.random.default_rng(1)
    for k, pose in enumerate(true_camera.good_poses(22, rng)):
        image = true_camera.photo(pose, rng, moved_px=25.0 if k == 8 else 0.0)
        cv2.imwrite(str(folder / f"{k:02d}.png"), image)
    cv2.imwrite(str(folder / "99.png"), np.full_like(image, 90))
    return folder


@pytest.fixture
def calibrate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Calibrate:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Result:
        return CliRunner().invoke(cli.app, ["calibrate", "intrinsics", *map(str, arguments)])

    return run


@pytest.mark.slow
def test_a_folder_gives_a_calibration_and_a_report(
    calibrate: Calibrate, photos: Path, tmp_path: Path, true_camera: TrueCamera
) -> None:
    file = tmp_path / "configs" / "cameras" / "ceiling.yaml"
    earlier = CameraModel(
        width=800, height=600, focal_px=(1.0, 1.0), centre_px=(0.0, 0.0), distortion=(), line_time_s=2e-5,
        T_world_camera=PoseSettings(position_m=(0.0, 0.0, 2.0), rotation_rad=(3.0, 0.0, 0.0)),
    )  # fmt: skip
    save(file, earlier)
    result = calibrate("ceiling", photos, "--device", "serial 7", "--report", "page.html")
    assert result.exit_code == 0 and result.stderr == ""
    model = load(file, CameraModel)
    assert (model.camera, model.width, model.height, model.lens) == ("serial 7", 800, 600, "pinhole")
    # Its place belonged to the earlier lens; the shutter is the same.
    assert model.T_world_camera is None and model.arena is None and model.line_time_s == 2e-5
    assert "run robofleet calibrate arena again" in result.stdout
    (kept,) = (file.parent / "earlier").iterdir()
    assert load(kept, CameraModel) == earlier
    assert str(kept.relative_to(tmp_path)) in result.stdout and "report: page.html" in result.stdout
    source = model.intrinsics
    assert source is not None
    assert source.parameters[:4] == ("f_x_px", "f_y_px", "c_x_px", "c_y_px")
    sigma = np.sqrt(np.diag(source.covariance))
    found = np.array([*model.focal_px, *model.centre_px, *model.distortion])
    assert np.all(np.abs(found - true_camera.values) < 4 * sigma)
    assert (
        "08.png" not in source.inputs
        and "99.png" not in source.inputs
        and len(source.inputs) == source.figures["views"]
    )
    assert "left out, as they do not fit: 08.png" in result.stdout
    page = (tmp_path / "page.html").read_text()
    assert (
        page.count("<svg") == 4
        and page.count("<img") == 21
        and "08.png" in page
        and "1 too little of the board" in page
    )
    assert "<script" not in page and 'src="http' not in page
    # A run takes it, but for the camera's place.
    tree = yaml.safe_load((ROOT / "configs" / "platoon.yaml").read_text())
    tree["camera"] |= {"model": "ceiling", "width": 800, "height": 600}
    tree["tracker"]["source"] = "truth"
    (tmp_path / "configs" / "lab.yaml").write_text(yaml.safe_dump(tree))
    assert load_config(tmp_path / "configs" / "lab.yaml").camera.model == model


@pytest.mark.slow
def test_centred_views_are_refused_with_a_report(calibrate: Calibrate, tmp_path: Path, true_camera: TrueCamera) -> None:
    folder, rng = tmp_path / "flat", np.random.default_rng(2)
    folder.mkdir()
    for k, pose in enumerate(true_camera.flat_poses(15, rng)):
        cv2.imwrite(str(folder / f"{k:02d}.png"), true_camera.photo(pose, rng, noise=6.0))
    result = calibrate("ceiling", folder, "--report", "page.html")
    assert result.exit_code == 2 and result.stdout == ""
    assert "focal length is uncertain" in result.stderr
    assert "next view: show the board" in result.stderr
    assert result.stderr.splitlines()[-1] == "nothing was written; report: page.html"
    assert not (tmp_path / "configs").exists()
    assert "next view: show the board" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_views_that_contradict_one_another_are_told_with_a_refusal(
    calibrate: Calibrate, photos: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "few"
    folder.mkdir()
    for file in sorted(photos.glob("*.png"))[:9]:  # too few, and the last is skewed
        (folder / file.name).write_bytes(file.read_bytes())
    result = calibrate("ceiling", folder, "--report", "page.html")
    assert result.exit_code == 2 and "8 views can be used: 12 or more are needed" in result.stderr
    assert "left out, as they do not fit: 08.png" in result.stderr
    assert result.stderr.splitlines()[-1] == "nothing was written; report: page.html"


@pytest.mark.slow
def test_mirrored_images_are_named_as_such(calibrate: Calibrate, photos: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mirrored"
    folder.mkdir()
    for file in sorted(photos.glob("0[0-3].png")):
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        cv2.imwrite(str(folder / file.name), image[:, ::-1])
    result = calibrate("ceiling", folder)
    assert result.exit_code == 2 and result.stderr.startswith("the images are mirrored")


def test_a_video_is_read(photos: Path, tmp_path: Path) -> None:
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"FFV1"), 10, (800, 600), isColor=False)
    assert writer.isOpened()
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in sorted(photos.glob("0[0-2].png"))]
    for image in (image for image in images for _ in range(2)):
        writer.write(image)
    writer.release()
    gathering = gather(film, Board())
    assert [view.name for view in gathering.views] == ["film.avi:frame 1", "film.avi:frame 3", "film.avi:frame 5"]
    assert np.array_equal(gathering.views[1].image, images[1])
    assert gathering.counts == {Offer.NEW: 3, Offer.MOVING: 3}  # the board had not held still yet


SMALL, OTHER = (cv2.imencode(".png", np.zeros((60, width), np.uint8))[1].tobytes() for width in (80, 90))
BROKEN, MIXED, EMPTY = {"a.png": b"no picture"}, {"a.png": SMALL, "b.png": OTHER}, {"notes.txt": b"nothing"}


@pytest.mark.parametrize(
    ("files", "options", "words"),
    [
        (BROKEN, (), "a.png"),
        (MIXED, (), "b.png: 90 x 60 px, but the first image has 80 x 60"),
        (EMPTY, (), "no image"),
        (b"this is no video", (), "input"),
        (None, (), "input"),  # is not there
        (MIXED, ("--squares", "11"), "--squares: '11'"),
        (MIXED, ("--squares", "11.5x8"), "--squares: '11.5x8'"),
        (MIXED, ("--squares", "3x3"), "too few corners"),
        (MIXED, ("--marker-mm", "50"), "do not fit"),
        (MIXED, ("--dictionary", "DICT_NONE"), "no dictionary DICT_NONE"),
        (MIXED, ("--coefficients", "6"), "--coefficients: a pinhole lens has 4, 5, 8, 12, 14, not 6"),
        (MIXED, ("--lens", "fisheye", "--coefficients", "5"), "a fisheye lens has 4, not 5"),
        (MIXED, ("--arena-m", "3x-2"), "--arena-m: '3x-2'"),
        (MIXED, ("--arena-m", "nanx2"), "--arena-m: 'nanx2'"),
        (MIXED, ("--height-m", "0.05"), "--height-m"),
        (MIXED, ("--live", "lab.yaml"), "--live"),
        (MIXED, ("--lens", "mirror"), "mirror"),
    ],
)
def test_bad_input_ends_at_the_edge(
    files: dict[str, bytes] | bytes | None,
    options: tuple[str, ...],
    words: str,
    calibrate: Calibrate,
    tmp_path: Path,
) -> None:
    source = tmp_path / "input"
    if isinstance(files, bytes):
        source.write_bytes(files)
    elif files is not None:
        source.mkdir()
        for name, content in files.items():
            (source / name).write_bytes(content)
    before = set(tmp_path.rglob("*"))
    result = calibrate("ceiling", source, *options)
    assert result.exit_code == 2
    assert words in result.stderr and "Traceback" not in result.stderr
    assert set(tmp_path.rglob("*")) == before


def test_a_name_that_is_none_and_no_source(calibrate: Calibrate) -> None:
    assert "'../x' is not a camera" in calibrate("../x", "folder").stderr
    assert "--set: it changes a configuration: name one" in calibrate("x", "f", "--set", "run.seed=1").stderr
    assert "name a folder or a video" in calibrate("ceiling").stderr


CAMERA = """
from pathlib import Path
import cv2
from robofleet.tracking.sources import Frame

class Camera:
    identity = "scripted"
    closed = False

    def __init__(self, context):
        self.images = [cv2.imread(str(f), 0) for f in sorted(Path({folder!r}).glob("*.png")) for _ in range(2)]

    def read(self):
        if not self.images:
            raise {end}
        return Frame(self.images.pop(0), 0)

    def close(self):
        Camera.closed = True
"""


@pytest.fixture
def scripted(photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Return a configuration whose camera shows the photos, each twice; its model is not there yet."""

    def make(end: str = "EOFError", *, only: str | None = None) -> Path:
        folder = photos
        if only is not None:
            folder = tmp_path / "some"
            folder.mkdir()
            for file in photos.glob(only):
                (folder / file.name).write_bytes(file.read_bytes())
        module = f"scripted_{len(sys.modules)}"
        (tmp_path / f"{module}.py").write_text(CAMERA.format(folder=str(folder), end=end))
        monkeypatch.syspath_prepend(tmp_path)
        tree = yaml.safe_load((ROOT / "configs" / "platoon.yaml").read_text())
        tree["camera"] = {"source": f"{module}:Camera", "model": "ceiling", "width": 800, "height": 600, "rate_hz": 30}
        tree["controller"]["alpha"] = 45.0
        config = tmp_path / "lab.yaml"
        config.write_text(yaml.safe_dump(tree))
        return config

    return make


@pytest.mark.long
def test_a_live_camera_is_read_until_its_lens_is_determined(
    calibrate: Calibrate, scripted: Callable[..., Path], tmp_path: Path
) -> None:
    config = scripted()
    result = calibrate("ceiling", "--live", config, "--report", "out/page.html")
    assert result.exit_code == 0
    model = load(tmp_path / "cameras" / "ceiling.yaml", CameraModel)  # beside the configuration, which looks there
    assert model.camera == "scripted"
    assert model.intrinsics is not None and 12 <= model.intrinsics.figures["views"] < 18  # type: ignore[operator]
    assert "next: show the board" in result.stderr and result.stderr.rstrip().endswith("done")
    assert sys.modules[yaml.safe_load(config.read_text())["camera"]["source"].split(":")[0]].Camera.closed
    # What the camera showed was kept: the same lens comes out of it again.
    again = gather(tmp_path / "out" / "views", Board())
    lens = measure(again.views, Conditions(Board(), "pinhole", 5, again.size, Ceiling(2.5, 0.08))).fit.lens
    assert model.focal_px == pytest.approx(lens.values[:2], rel=1e-6)


@pytest.mark.slow
def test_a_capture_that_is_broken_off_is_judged_by_what_it_has(
    calibrate: Calibrate, scripted: Callable[..., Path], tmp_path: Path
) -> None:
    result = calibrate("ceiling", "--live", scripted("KeyboardInterrupt", only="0[0-4].png"))
    assert result.exit_code == 2
    assert "5 views can be used: 12 or more are needed" in result.stderr
    assert "nothing was written" in result.stderr and not (tmp_path / "cameras").exists()
    (views,) = (tmp_path / "runs").rglob("views")
    assert len(list(views.iterdir())) == 5


def test_the_live_configuration_needs_no_calibration_but_all_the_rest(
    calibrate: Calibrate, scripted: Callable[..., Path]
) -> None:
    config = scripted()
    text = config.read_text()
    config.write_text(text.replace("tag: 2", "tag: 1"))
    assert "robots.0's already" in calibrate("ceiling", "--live", config).stderr
    config.write_text(text.replace("scripted_", "nowhere_"))
    assert "camera.source: 'nowhere_" in calibrate("ceiling", "--live", config).stderr
    assert "there is no such file" in calibrate("ceiling", "--live", "none.yaml").stderr
    changed = calibrate("ceiling", "--live", config, "--set", "camera.width=1.5")
    assert "camera.width" in changed.stderr
    config.write_text(text.replace("width: 800", "width: 640"))
    again = calibrate("ceiling", "--live", config, "--set", "camera.width=800", "--set", "camera.rate_hz=-1")
    assert len(again.stderr.splitlines()) == 1  # the size is right now
    assert "camera.rate_hz" in again.stderr
    config.write_text("camera: [")
    assert "lab.yaml" in calibrate("ceiling", "--live", config).stderr


@pytest.mark.slow
def test_the_screen_shows_what_was_seen_and_what_is_missing(photos: Path) -> None:
    board = Board()
    gathering = Gathering(board, film=False)
    for k in range(6):
        name = f"{k:02d}.png"
        gathering.take(name, np.asarray(cv2.imread(str(photos / name), cv2.IMREAD_GRAYSCALE), np.uint8))
    result = measure(gathering.views, Conditions(board, "pinhole", 5, gathering.size, Ceiling(2.5, 0.08)))
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(picture(gathering, result, Offer.ALIKE))
    lines = console.export_text().splitlines()
    assert "too similar" in lines[0]
    rows = [line for line in lines if line.startswith("│")]
    counts = [[int(cell) for cell in row.split("│")[1:-1]] for row in rows[::2]]
    assert counts == result.coverage.corners.tolist()
    assert any(f"next: {result.wanted}"[:60] in line for line in lines)
    assert max(map(len, lines)) <= 80
