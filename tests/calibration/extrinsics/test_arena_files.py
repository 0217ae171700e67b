"""From images and a survey to a camera's file and back: `robofleet calibrate arena` and `verify` on rendered floors."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration.extrinsics.fiducials import look
from robofleet.calibration.extrinsics.placing import moved
from robofleet.calibration.extrinsics.survey import Survey
from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Image
from robofleet.tracking.camera import CameraGeometry

ROOT = Path(__file__).parents[3]
MODEL = CameraModel.model_validate(yaml.safe_load((ROOT / "configs/cameras/overhead.yaml").read_text()))
TRUTH = CameraGeometry.from_model(MODEL)
SIZE = (MODEL.width, MODEL.height)
SIDE = 0.1
LAYOUT = [(-1.4, -0.85), (-1.4, 0.85), (1.4, -0.85), (1.4, 0.85), (0.0, 0.9), (0.0, -0.9), (-0.7, 0.0), (0.7, 0.1)]
FIRST = 100  # id of the first tag
SUB = 4  # points a pixel, each way
BLUR_PX = 0.5

Pose = tuple[float, float, float]
FLOOR: list[Pose] = [(x, y, 0.9 * k - 3.0) for k, (x, y) in enumerate(LAYOUT)]


def rendered(camera: CameraGeometry, poses: Sequence[Pose], rng: np.random.Generator, first: int = FIRST) -> Image:
    """The floor with tags ``first``, ... at x, y [m], psi [rad]: sharp prints behind every pixel, then blur."""
    width, height = SIZE
    image = np.full((height, width), 120.0) + 30.0 * np.linspace(-1, 1, width)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for tag, (x, y, psi) in enumerate(poses, first):
        u, v = camera.project(np.array([[x, y, 0.0]]))[0]
        half = math.ceil(0.95 * SIDE * 830.0 / 2.4)
        left, top = max(0, int(u) - half), max(0, int(v) - half)
        right, bottom = min(width, int(u) + half), min(height, int(v) + half)
        if left >= right or top >= bottom:
            continue
        us = left + (np.arange((right - left) * SUB) + 0.5) / SUB - 0.5
        vs = top + (np.arange((bottom - top) * SUB) + 0.5) / SUB - 0.5
        pixels = np.stack(np.meshgrid(us, vs), -1).reshape(-1, 2)
        d = camera.to_plane(pixels, 0.0) - [x, y]
        ahead, aside = d @ [math.cos(psi), math.sin(psi)], d @ [-math.sin(psi), math.cos(psi)]
        column, row = np.floor(8 * ahead / SIDE + 5).astype(int), np.floor(5 - 8 * aside / SIDE).astype(int)
        cells = np.pad(family.generateImageMarker(tag, 8), 1, constant_values=255) > 0
        on = (column >= 0) & (column < 10) & (row >= 0) & (row < 10)
        base = np.repeat(np.repeat(image[top:bottom, left:right], SUB, 0), SUB, 1).ravel()
        sharp = np.where(on, np.where(cells[row.clip(0, 9), column.clip(0, 9)], 215.0, 30.0), base)
        sharp = cv2.GaussianBlur(sharp.reshape(len(vs), len(us)), (0, 0), BLUR_PX * SUB)
        image[top:bottom, left:right] = sharp.reshape(bottom - top, SUB, right - left, SUB).mean((1, 3))
    return np.clip(np.rint(image + rng.normal(0.0, 3.0, image.shape)), 0, 255).astype(np.uint8)


def surveyed(poses: Sequence[Pose], rng: np.random.Generator, sigma: float = 5e-4) -> list[dict[str, Any]]:
    return [
        {
            "tag": tag,
            "side_m": SIDE,
            "x_m": x + float(rng.normal(0, sigma)),
            "y_m": y + float(rng.normal(0, sigma)),
            "heading_deg": math.degrees(psi) + float(rng.normal(0, 0.3)),
        }
        for tag, (x, y, psi) in enumerate(poses, FIRST)
    ]


class Lab:
    """A folder with a lens, a survey and an image, and the tool."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.camera, self.survey, self.image = folder / "overhead.yaml", folder / "survey.yaml", folder / "floor.png"
        self.report = folder / "report.html"
        self.write(
            self.camera, MODEL.model_copy(update={"T_world_camera": None}).model_dump(mode="json", exclude_none=True)
        )

    def write(self, file: Path, tree: object) -> None:
        file.write_text(yaml.safe_dump(tree))

    def show(self, image: Image, tags: object) -> None:
        cv2.imwrite(str(self.image), image)
        self.write(self.survey, {"floor_tags": tags})

    def run(self, *arguments: object) -> Result:
        return CliRunner().invoke(cli.app, ["calibrate", *map(str, arguments)])

    def arena(self, *more: object) -> Result:
        return self.run("arena", self.camera, self.survey, self.image, "--report", self.report, *more)

    def verify(self, image: Path, *more: object) -> Result:
        return self.run("verify", self.camera, self.survey, image, *more)


def good(done: Result) -> str:
    assert done.exit_code == 0, done.output
    return done.output


def refused(done: Result) -> str:
    assert done.exit_code == 2, done.output
    assert "Traceback" not in done.output
    return done.output


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


@pytest.fixture(scope="module")
def floor() -> Image:
    return rendered(TRUTH, FLOOR, np.random.default_rng(1))


def error_mm(lab: Lab, height: float = 0.0) -> float:
    """True error on the arena, rms."""
    found = CameraGeometry.from_model(CameraModel.model_validate(yaml.safe_load(lab.camera.read_text())))
    X, Y = np.meshgrid(np.linspace(-1.6, 1.6, 9), np.linspace(-1.0, 1.0, 7))
    points = np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, height)])
    off = found.to_plane(TRUTH.project(points), height) - points[:, :2]
    return 1e3 * math.sqrt(float((off**2).sum(1).mean()))


def test_tags_are_found_to_a_fraction_of_a_pixel(floor: Image) -> None:
    seen = look(Survey.model_validate({"floor_tags": surveyed(FLOOR, np.random.default_rng(2))}), [("", floor)], SIZE)
    edge = [(x + SIDE / 2 * math.cos(psi), y + SIDE / 2 * math.sin(psi), 0.0) for x, y, psi in FLOOR]
    assert np.abs(seen.marks.pixels - TRUTH.project(np.array([(x, y, 0.0) for x, y, _ in FLOOR]))).max() < 0.05
    assert np.abs(seen.marks.ahead - TRUTH.project(np.array(edge))).max() < 0.1
    assert seen.notes == ()


@pytest.mark.slow
def test_images_average_and_show_what_moved_meanwhile(floor: Image) -> None:
    rng = np.random.default_rng(3)
    survey = Survey.model_validate({"floor_tags": surveyed(FLOOR, rng)})
    noisy = [("", np.clip(floor + rng.normal(0, 12, floor.shape), 0, 255).astype(np.uint8)) for _ in range(4)]
    u, v = TRUTH.project(np.array([(*LAYOUT[7], 0.0)]))[0].astype(int)
    noisy[2][1][v - 30 : v + 30, u - 31 : u + 29] = noisy[1][1][v - 30 : v + 30, u - 30 : u + 30]
    seen = look(survey, noisy, SIZE)
    assert seen.notes == ("tag 107: moved while images were taken; left out",)
    assert len(seen.marks) == 7
    off = seen.marks.pixels - TRUTH.project(np.array([(*position, 0.0) for position in LAYOUT[:7]]))
    assert np.sqrt((off**2).mean()) < 2.0 * seen.marks.sigma_px.max() < 0.1
    each = np.array([look(survey, [image], SIZE).marks.pixels[:7] for image in noisy])
    assert seen.marks.sigma_px == pytest.approx(np.sqrt(each.var(axis=0, ddof=1).mean(axis=1) / 4).clip(0.01), rel=1e-6)


def test_print_that_only_reads_like_a_tag_is_not_taken() -> None:
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    survey = Survey.model_validate({"floor_tags": surveyed(FLOOR, np.random.default_rng(14))})
    for flipped, expected in ((0, ("tag 100",)), (3, ())):  # cells; what OpenCV corrects by default
        marker = family.generateImageMarker(FIRST, 8)
        marker[2, 1 : 1 + flipped] = 255 - marker[2, 1 : 1 + flipped]
        image = np.full(SIZE[::-1], 120, np.uint8)
        image[300:340, 700:740] = np.kron(np.pad(marker, 1, constant_values=255), np.ones((4, 4), np.uint8))
        assert look(survey, [("", image)], SIZE).marks.names == expected


@pytest.mark.slow
def test_camera_is_placed_and_verified(lab: Lab, floor: Image) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(4)))
    good(lab.arena("--arena-m", "3.2x2.0"))
    assert error_mm(lab) < 0.6
    tree = yaml.safe_load(lab.camera.read_text())
    figures = tree["arena"]["figures"]
    assert 0.2 < figures["predicted_rms_mm"] < 0.6
    assert figures["marks_used"] == 8
    assert np.linalg.eigvalsh(np.array(tree["arena"]["covariance"])).min() > 0
    assert set(tree["arena"]["inputs"]) == {"overhead.yaml", "survey.yaml", "images"}
    page = lab.report.read_text()
    assert page.count("<svg") == 2
    assert "http" not in page.split("<svg")[0]
    good(lab.verify(lab.image))
    first = lab.camera.read_bytes()
    good(lab.arena("--arena-m", "3.2x2.0"))
    assert first in [kept.read_bytes() for kept in (lab.folder / "earlier").iterdir()]


@pytest.mark.slow
def test_a_camera_is_named_as_a_configuration_names_it(lab: Lab, floor: Image, monkeypatch: pytest.MonkeyPatch) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(4)))
    file = lab.folder / "configs" / "cameras" / "overhead.yaml"
    file.parent.mkdir(parents=True)
    lab.camera.rename(file)
    monkeypatch.chdir(lab.folder)
    assert "configs/cameras/overhead.yaml: written" in good(
        lab.run("arena", "overhead", "survey.yaml", "floor.png", "--arena-m", "3.2x2.0")
    )
    good(lab.run("verify", "overhead", "survey.yaml", "floor.png"))
    monkeypatch.chdir("/")
    good(lab.run("verify", "overhead", lab.survey, lab.image, "--configs", lab.folder / "configs"))
    misspelt = lab.run("verify", "overhaed", lab.survey, lab.image, "--configs", lab.folder / "configs")
    assert "overhaed.yaml (did you mean overhead?)" in refused(misspelt)
    other = lab.folder / "other.yaml"
    assert f"there is no camera {other}" in refused(lab.run("verify", other, lab.survey, lab.image))


def test_the_live_camera_is_changed_by_set(lab: Lab) -> None:
    lab.write(lab.survey, {"floor_tags": surveyed(FLOOR, np.random.default_rng(4))})
    command = "verify", "overhead", lab.survey, "--live", ROOT / "configs" / "platoon.yaml", "--set"
    assert "there is no camera 'nothing'" in refused(lab.run(*command, "camera.source=nothing"))
    assert "unknown key" in refused(lab.run(*command, "camera.sorce=v4l2"))


@pytest.mark.slow
def test_knock_and_a_moved_tag_are_told_apart(lab: Lab, floor: Image) -> None:
    rng = np.random.default_rng(5)
    lab.show(floor, surveyed(FLOOR, rng))
    good(lab.arena())
    before = lab.camera.read_bytes()
    angle = math.radians(0.4)
    knocked = TRUTH.moved(moved(TRUTH.T_world_camera, np.array([angle, 0.0, 0.0, 0.0, 0.0, 0.0])))
    cv2.imwrite(str(lab.folder / "knocked.png"), rendered(knocked, FLOOR, rng))
    output = refused(lab.verify(lab.folder / "knocked.png"))
    assert "the camera was knocked" in output
    assert "turned by 0.4 degrees" in output
    assert "tag" not in output
    pushed = [*FLOOR[:3], (FLOOR[3][0] - 0.012, *FLOOR[3][1:]), *FLOOR[4:]]
    cv2.imwrite(str(lab.folder / "pushed.png"), rendered(TRUTH, pushed, rng))
    output = refused(lab.verify(lab.folder / "pushed.png"))
    assert "the camera is in its place" in output
    assert output.count("from where it was at the calibration (") == 1
    assert "tag 103: lies 1" in output
    assert lab.camera.read_bytes() == before
    few = rendered(TRUTH, FLOOR[:3], rng)
    cv2.imwrite(str(lab.folder / "few.png"), few)
    output = refused(lab.verify(lab.folder / "few.png"))
    assert "cannot tell: 3 surveyed marks are in sight" in output
    assert "tag 105: is surveyed, but is in no image" in output


@pytest.mark.slow
def test_a_third_of_a_millimetre_shows_through_an_uncertain_lens(lab: Lab, floor: Image) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(16)))
    sigma = [0.5, 0.5, 0.6, 0.6, 6e-4, 8e-4, 1e-4, 1e-4, 3e-4]
    lens = {"date": "", "tool": "", "inputs": {}, "figures": {}, "covariance": np.diag(np.square(sigma)).tolist()}
    lab.write(lab.camera, yaml.safe_load(lab.camera.read_text()) | {"intrinsics": lens})
    good(lab.arena())
    for k, shift in enumerate([(0.0, 0.0, 0.0), (3e-4, 0.0, 0.0), (0.0, 0.0, 3e-4)]):
        camera = TRUTH.moved(moved(TRUTH.T_world_camera, np.array([0.0, 0.0, 0.0, *shift])))
        cv2.imwrite(str(lab.folder / "now.png"), rendered(camera, FLOOR, np.random.default_rng(20 + k)))
        output = (refused if any(shift) else good)(lab.verify(lab.folder / "now.png"))
        assert ("the camera was knocked" in output) == any(shift)


def test_mirrored_images_are_named_as_such(lab: Lab, floor: Image) -> None:
    lab.show(floor[:, ::-1], surveyed(FLOOR, np.random.default_rng(17)))
    assert refused(lab.arena()).startswith("the images are mirrored")


@pytest.mark.slow
def test_wrong_survey_is_named_and_left_out(lab: Lab, floor: Image) -> None:
    tags = surveyed(FLOOR, np.random.default_rng(6))
    tags[5]["x_m"] += 0.02
    tags[2]["heading_deg"] += 90.0
    lab.show(floor, tags)
    output = good(lab.arena())
    assert [line.split(":")[0] for line in output.splitlines() if "left out" in line] == ["tag 105"]
    assert "tag 105: lies 2" in output
    assert "tag 102: is turned by -9" in output
    assert error_mm(lab) < 0.7


@pytest.mark.slow
def test_a_poor_survey_is_refused(lab: Lab, floor: Image) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(15), sigma=0.02))
    before = lab.camera.read_bytes()
    assert "mm rms off on the arena, more than 3" in refused(lab.arena())
    lab.write(lab.survey, {"floor_tags": surveyed(FLOOR, np.random.default_rng(11), sigma=0.0012)})
    assert "too much for a survey of 0.5 mm" in refused(lab.arena("--survey-mm", 0.5))
    assert lab.camera.read_bytes() == before
    good(lab.arena("--survey-mm", 1.2))
    tags = surveyed(FLOOR, np.random.default_rng(11))
    tags[1]["x_m"] += 0.02
    tags[6]["y_m"] += 0.02
    lab.write(lab.survey, {"floor_tags": tags})
    words = "2 marks were left out: if their surveys are right, 0.5 mm was stated too small"
    assert words in good(lab.arena("--survey-mm", 0.5))


@pytest.mark.slow
def test_points_read_off_an_image_need_no_image(lab: Lab) -> None:
    rng = np.random.default_rng(7)
    points = []
    for k, (x, y) in enumerate([*LAYOUT, (0.2, 0.4), (-0.3, -0.5), (1.2, 0.0), (-1.2, 0.2)]):
        height = 0.3 if k % 3 == 0 else 0.0
        u, v = TRUTH.project(np.array([[x, y, height]]))[0] + rng.normal(0, 0.5, 2)
        point = {"name": f"cross {k}", "x_m": x, "y_m": y, "height_m": height, "u_px": float(u), "v_px": float(v)}
        points.append(point)
    lab.write(lab.survey, {"points": points})
    good(lab.run("arena", lab.camera, lab.survey, "--report", lab.report))
    assert error_mm(lab) < 3.0
    points[4]["u_px"] = 1300.0
    lab.write(lab.survey, {"points": points})
    assert "cross 4: u_px, v_px: 1300" in refused(lab.run("arena", lab.camera, lab.survey, "--report", lab.report))


@pytest.mark.slow
def test_strangers_twins_and_the_missing_are_named(lab: Lab) -> None:
    rng = np.random.default_rng(8)
    image = rendered(TRUTH, [*FLOOR[:7], (0.3, 0.5, 0.0)], rng)  # tag 107 elsewhere: the survey lacks it
    u, v = TRUTH.project(np.array([(*LAYOUT[6], 0.0)]))[0].astype(int)
    image[v - 60 : v, u + 100 : u + 160] = image[v - 30 : v + 30, u - 30 : u + 30]  # tag 106 again
    cv2.imwrite(str(lab.image), image)
    tags = surveyed(FLOOR, rng)
    tags[7]["tag"] = 300
    lab.write(lab.survey, {"floor_tags": tags})
    output = good(lab.arena("--survey-mm", 0.5))
    assert "tag 300: is surveyed, but is in no image" in output
    assert "tag 106: two prints of it are in one image" in output
    assert "tag 107: is in the images, but not in the survey" in output
    assert yaml.safe_load(lab.camera.read_text())["arena"]["figures"]["marks_used"] == 6


@pytest.mark.long
def test_live_images_come_from_the_configured_camera(lab: Lab) -> None:
    lab.write(lab.survey, {"floor_tags": surveyed(FLOOR, np.random.default_rng(9))})
    live = "--live", ROOT / "configs/platoon.yaml", "--frames", 2
    seen = lab.run("verify", ROOT / "configs/cameras/overhead.yaml", lab.survey, "--survey-mm", 0.5, *live)
    assert "cannot tell: 0 surveyed marks are in sight" in refused(seen)
    assert "give one of them" in refused(lab.verify(lab.image, "--live", ROOT / "configs/platoon.yaml"))


def _side(tags: list[dict[str, Any]]) -> None:
    for tag in tags:
        tag["side_m"] = 0.2


def _mirror(tags: list[dict[str, Any]]) -> None:
    for tag in tags:
        tag["x_m"] = -tag["x_m"]


def _line(tags: list[dict[str, Any]]) -> None:
    for k, tag in enumerate(tags):
        tag["x_m"], tag["y_m"] = 0.3 * k - 1.0, 0.2 * k


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (_side, "side_m or the survey's unit is wrong"),
        (_mirror, ""),
        (_line, "lie on one line"),
        (
            lambda tags: tags.__delitem__(slice(3, None)),
            "4 tags and points or more place a camera, and this survey has 3",
        ),
        (lambda tags: tags.__delitem__(slice(4, None)), "state it with --survey-mm"),
        (lambda tags: tags[1].update(tag=tags[0]["tag"]), "floor_tags.1: 100 is floor_tags.0's already"),
        (lambda tags: tags[1].update(x_m=tags[0]["x_m"], y_m=tags[0]["y_m"]), "floor_tags.1: lies where floor_tags.0"),
        (lambda tags: tags[1].update(side_m=-0.1), "floor_tags.1.side_m: must be at least 0.001"),
        (lambda tags: tags[1].update(x_m=math.nan), "floor_tags.1.x_m: must be a finite number"),
        (lambda tags: tags[1].update(tga=7), "floor_tags.1.tga: unknown key: did you mean 'tag'?"),
        (lambda tags: tags[1].pop("y_m"), "floor_tags.1.y_m: is missing"),
    ],
)
def test_impossible_surveys_are_refused(lab: Lab, floor: Image, spoil: Any, reason: str) -> None:
    tags = surveyed(FLOOR, np.random.default_rng(10))
    spoil(tags)
    lab.show(floor, tags)
    before = lab.camera.read_bytes()
    assert reason in refused(lab.arena())
    assert lab.camera.read_bytes() == before
    assert sorted(file.name for file in lab.folder.iterdir()) == ["floor.png", "overhead.yaml", "survey.yaml"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "survey.yaml:1:1: is empty"),
        ("- {tag: 100}", "survey.yaml: must be a mapping"),
        ("floor_tags: [", "is not YAML"),
        ("points: [{name: 7, x_m: 0, y_m: 0, u_px: 1, v_px: 1}]", "points.0.name: must be text, not 7: quote it"),
    ],
)
def test_what_is_no_survey_is_refused(lab: Lab, text: str, reason: str) -> None:
    lab.survey.write_text(text)
    lab.image.touch()
    assert reason in refused(lab.run("verify", lab.camera, lab.survey))


@pytest.mark.slow
def test_arena_must_be_one(lab: Lab, floor: Image) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(13)))
    assert "--arena-m: '0x2': each side must be more than 0" in refused(lab.arena("--arena-m", "0x2"))
    assert "--arena-m: '3.2' is not a size: write two numbers" in refused(lab.arena("--arena-m", "3.2"))
    assert "% of the arena" in good(lab.arena("--arena-m", "8X2"))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"width": 1920}, "floor.png: is 1280 x 720 px, but the camera is calibrated for 1920 x 720"),
        ({"distortion": [0.1, 0.2, 0.3]}, "a pinhole lens has 0, 4, 5, 8, 12 or 14 coefficients, not 3"),
        ({"distrotion": []}, "did you mean 'distortion'?"),
        ({"focal_px": [0.0, 830.0]}, "focal_px.0: must be at least 1"),
        ({"intrinsics": {"covariance": [[1.0]]}}, "intrinsics.covariance: must have 9 rows of 9 numbers"),
        ({"intrinsics": {"covariance": (-np.eye(9)).tolist()}}, "intrinsics.covariance: is not a valid covariance"),
    ],
)
def test_impossible_cameras_are_refused(lab: Lab, floor: Image, change: dict[str, Any], reason: str) -> None:
    lab.show(floor, surveyed(FLOOR, np.random.default_rng(11)))
    if "intrinsics" in change:
        change["intrinsics"] |= {"date": "", "tool": "", "inputs": {}, "figures": {}}
    lab.write(lab.camera, yaml.safe_load(lab.camera.read_text()) | change)
    assert reason in refused(lab.arena())
    refused(lab.verify(lab.image))
    assert not lab.report.exists()


def test_what_is_no_image_is_refused(lab: Lab) -> None:
    lab.write(lab.survey, {"floor_tags": surveyed(FLOOR, np.random.default_rng(12))})
    for content, reason in ((None, "No such file"), (b"no picture", "cannot be read as an image")):
        if content is not None:
            lab.image.write_bytes(content)
        assert reason in refused(lab.arena())
    (lab.folder / "empty").mkdir()
    assert "there is no image in this folder" in refused(lab.run("arena", lab.camera, lab.survey, lab.folder / "empty"))
    assert "no image to find them in" in refused(lab.run("arena", lab.camera, lab.survey))
