"""The sheets as a printer gets them: the files' own coordinates, drawn with OpenCV, and read back by its detectors."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import cv2
import matplotlib as mpl
import numpy as np
import pyapriltags
import pytest
import yaml
from click.testing import Result
from numpy.typing import NDArray
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration import sheets

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"
MM_PER_PT = 25.4 / 72.0
PX_PER_MM = 5

Loops = list[NDArray[np.float64]]  # closed polygons (n, 2) [mm; right and down from the page's upper left corner]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["sheet", *map(str, arguments)])


def drawn(*arguments: object) -> str:
    """Run the tool, and return what it printed."""
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done.stdout


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", text)]


def shapes(svg: Path) -> tuple[tuple[float, float], dict[str, Loops]]:
    """The page's size [mm], and the polygons of what has a name in the file."""
    page = ElementTree.parse(svg).getroot()
    size = numbers(page.attrib["width"])[0] * MM_PER_PT, numbers(page.attrib["height"])[0] * MM_PER_PT
    assert numbers(page.attrib["viewBox"])[2:] == numbers(page.attrib["width"]) + numbers(page.attrib["height"])
    named = {}
    for group in page.iter(f"{SVG}g"):
        path = group.find(f"{SVG}path")
        if path is not None and "transform" not in path.attrib:
            parts = path.attrib["d"].split("M")[1:]
            named[group.attrib["id"]] = [np.array(numbers(part)).reshape(-1, 2) * MM_PER_PT for part in parts]
    return size, named


def extent(loops: Loops) -> NDArray[np.float64]:
    """x, y of the upper left corner, width, height [mm]."""
    points = np.concatenate(loops)
    return np.concatenate([points.min(0), np.ptp(points, axis=0)])


def picture(size: tuple[float, float], loops: Loops) -> NDArray[np.uint8]:
    """What a perfect printer makes of upright polygons: each pixel as dark as its area is inside.

    Every vertical edge adds or takes away what is right of it: holes must go round the other way.
    """
    width, height = (round(side * PX_PER_MM) for side in size)
    steps = np.zeros((height, width + 1))
    for loop in loops:
        corners = loop * PX_PER_MM
        for (x, start), (to, end) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            low, high = min(start, end), max(start, end)
            rows = np.arange(int(low), min(int(high) + 1, height))
            if abs(to - x) > 1e-3:
                assert high - low < 1e-3  # upright
                continue
            inside = np.copysign(np.clip(np.minimum(rows + 1, high) - np.maximum(rows, low), 0, 1), end - start)
            steps[rows, int(x)] += inside * (1 - x % 1)
            steps[rows, int(x) + 1] += inside * (x % 1)
    ink = np.abs(np.cumsum(steps, axis=1)[:, :-1])
    assert ink.max() < 1.001
    return np.round(255 * (1 - np.minimum(ink, 1))).astype(np.uint8)


def test_tags_are_where_and_as_large_as_they_say(tmp_path: Path) -> None:
    output = drawn("tags", "--ids", "1-4,586", "--side-mm", "70", "--out", tmp_path / "tags.svg")
    files = [tmp_path / "tags-1.svg", tmp_path / "tags-2.svg"]
    assert output.split() == [str(file) for file in files]
    seen: dict[int, NDArray[np.float64]] = {}
    for file in files:
        size, named = shapes(file)
        assert size == pytest.approx((210.0, 297.0), abs=1e-4)
        tags = {name: loops for name, loops in named.items() if name.startswith("tag-")}
        for name, loops in tags.items():
            x, y, width, height = extent(loops)
            assert (width, height) == pytest.approx((70.0, 70.0), abs=1e-3)
            assert min(x, y, size[0] - x - width, size[1] - y - height) > 70 / 8 + 8  # a white cell, and the margin
            arrow = extent(named[f"forward-{name[4:]}"])
            assert arrow[0] > x + width + 70 / 8
            assert arrow[1] + arrow[3] / 2 == pytest.approx(y + height / 2, abs=1e-3)
        assert extent(named["ruler-across"])[2] == pytest.approx(150.0, abs=1e-3)
        assert extent(named["ruler-up"])[3] == pytest.approx(250.0, abs=1e-3)
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        image = picture(size, [loop for loops in tags.values() for loop in loops])
        corners, ids, _ = cv2.aruco.ArucoDetector(family).detectMarkers(image)
        seen |= dict(zip(ids.ravel().tolist(), (c[0] for c in corners), strict=True))
        for tag, points in zip(ids.ravel().tolist(), corners, strict=True):
            top_left, top_right, _, bottom_left = points[0] / PX_PER_MM  # as OpenCV prints it: right is forward
            assert top_right - top_left == pytest.approx([70.0, 0.0], abs=0.25)
            assert bottom_left - top_left == pytest.approx([0.0, 70.0], abs=0.25)
            assert top_left == pytest.approx(extent(tags[f"tag-{tag}"])[:2], abs=0.25)
            # The detector corrects cells that are wrong: look at each.
            where = extent(tags[f"tag-{tag}"])[:2] + (np.arange(8)[:, None] + 0.5) * 70 / 8
            across, down = np.floor(where * PX_PER_MM).astype(int).T
            assert np.array_equal(image[np.ix_(down, across)], family.generateImageMarker(tag, 8))
    assert sorted(seen) == [1, 2, 3, 4, 586]


def test_tags_with_bits_around_are_as_large_as_they_say(tmp_path: Path) -> None:
    file, family = tmp_path / "tags.svg", "Standard41h12"
    drawn("tags", "--ids", "3,2114", "--side-mm", "50", "--family", family, "--out", file)
    size, named = shapes(file)
    tags = {name: loops for name, loops in named.items() if name.startswith("tag-")}
    image = picture(size, [loop for loops in tags.values() for loop in loops])
    found = pyapriltags.Detector(families=f"tag{family}", quad_decimate=1.0).detect(image)
    assert sorted(tag.tag_id for tag in found) == [3, 2114]
    for tag in found:
        top_right, top_left, _, bottom_right = tag.corners / PX_PER_MM  # half a turn from that library's images
        assert top_right - top_left == pytest.approx([50.0, 0.0], abs=0.25)
        assert bottom_right - top_right == pytest.approx([0.0, 50.0], abs=0.25)
        arrow = extent(named[f"forward-{tag.tag_id}"])
        assert arrow[0] > top_right[0] + 3 * 10.0  # two cells of bits, and a white one
        assert arrow[1] + arrow[3] / 2 == pytest.approx((top_right[1] + bottom_right[1]) / 2, abs=0.25)


@pytest.mark.parametrize(
    ("options", "size", "squares"),
    [
        (["--paper", "A3"], (420.0, 297.0), (9, 6)),
        (["--paper", "a2"], (594.0, 420.0), (11, 8)),
        (["--squares", "5x7", "--square-mm", "30", "--marker-mm", "22.5", "--paper", "letter"], (215.9, 279.4), (5, 7)),
    ],
)
def test_boards(options: list[str], size: tuple[float, float], squares: tuple[int, int], tmp_path: Path) -> None:
    output = drawn("board", *options, "--out", tmp_path / "new" / "board.svg")
    given = dict(zip(options[::2], options[1::2], strict=True))
    square, marker = float(given.get("--square-mm", 40)), float(given.get("--marker-mm", 30))
    named_so = f"intrinsics --squares {squares[0]}x{squares[1]} --square-mm {square:g} --marker-mm {marker:g}"
    assert named_so in output
    paper, named = shapes(tmp_path / "new" / "board.svg")
    assert paper == pytest.approx(size, abs=1e-4)
    x, y, width, height = extent(named["chessboard"])
    assert (width, height) == pytest.approx((squares[0] * square, squares[1] * square), abs=2e-3)
    assert min(x, y, paper[0] - x - width) > 10.0
    inked = [loop for name, loops in named.items() if name.startswith(("chess", "marker")) for loop in loops]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    board = cv2.aruco.CharucoBoard(squares, square, marker, dictionary)
    for name, object_points in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        ends = np.concatenate([object_points[0, :2] + [x, y], [marker, marker]])
        assert extent(named[f"marker-{name}"]) == pytest.approx(ends, abs=2e-3)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(board).detectBoard(picture(paper, inked))
    assert sorted(ids.ravel()) == list(range((squares[0] - 1) * (squares[1] - 1)))
    assert len(markers) == squares[0] * squares[1] // 2
    where = board.getChessboardCorners()[ids.ravel(), :2] + [x, y]
    assert (corners[:, 0] + 0.5) / PX_PER_MM == pytest.approx(where, abs=0.05)


LAB = ROOT / "configs" / "lab.yaml"


def test_floor_tags_are_true_to_scale_and_the_survey_shows_where_they_lie(tmp_path: Path) -> None:
    out = tmp_path / "floor.svg"
    changes = ("--set", "robots.1.tag=501", "--set", "arena.size_m=[3.2, 2.4]")
    output = drawn("floor", LAB, "--out", out, "--count", "6", "--side-mm", "80", *changes)
    ids = [500, 502, 503, 504, 505, 506]  # 501 is a robot's
    survey = yaml.safe_load(re.findall(r"^floor_tags:\n(?:  - .*\n)+", output, re.MULTILINE)[0])
    assert survey == {"floor_tags": [{"tag": tag, "side_m": 0.08, "x_m": None, "y_m": None} for tag in ids]}
    files = sorted(tmp_path.iterdir(), key=lambda file: int(file.stem.partition("-")[2]))
    (size, plan), *prints = map(shapes, files)
    assert size == pytest.approx((210.0, 297.0), abs=1e-4)
    sides = {name: extent(loops)[2:] for _, named in prints for name, loops in named.items() if name.startswith("tag-")}
    assert set(sides) == {f"tag-{tag}" for tag in ids}
    assert all(side == pytest.approx([80.0, 80.0], abs=1e-3) for side in sides.values())
    middles = {tag: extent(plan[f"place-{tag}"]) for tag in ids}
    at = {tag: x_y_w_h[:2] + x_y_w_h[2:] / 2 for tag, x_y_w_h in middles.items()}
    metre = (at[502][0] - at[500][0]) / (3.2 - sheets.piece_side(80.0) / 1e3)
    assert at[502] - at[500] == pytest.approx([(at[502] - at[500])[0], 0.0], abs=1e-3)
    assert (at[500][1] - at[503][1]) / metre == pytest.approx(2.4 - sheets.piece_side(80.0) / 1e3, abs=0.02)
    (left, top), (right, bottom) = np.min(list(at.values()), 0), np.max(list(at.values()), 0)
    assert 10.0 < left < right < 200.0
    assert 10.0 < top < bottom < 150.0


def test_floor_tags_of_a_configuration_are_printed_again_however_many(tmp_path: Path) -> None:
    tags = [{"tag": 300 + k, "side_m": 0.06 + 0.01 * (k % 2), "x_m": 0.1 * k - 1.0, "y_m": 0.9} for k in range(20)]
    changes = f"tracker.floor_tags={json.dumps(tags)}"
    assert "survey.yaml" not in drawn("floor", LAB, "--out", tmp_path / "f.svg", "--set", changes)
    named = {name: loops for file in tmp_path.iterdir() for name, loops in shapes(file)[1].items()}
    for tag in tags:
        assert extent(named[f"tag-{tag['tag']}"])[2] == pytest.approx(1e3 * tag["side_m"], abs=1e-3)
        assert f"place-{tag['tag']}" in named


def test_pdf_is_the_same_drawing(tmp_path: Path) -> None:
    with mpl.rc_context({"pdf.compression": 0, "savefig.bbox": "tight"}):  # a user's own settings: no change of scale
        for name in ("tags.pdf", "tags.svg"):
            drawn("tags", "--ids", "0-4", "--paper", "letter", "--out", tmp_path / name)
    data = (tmp_path / "tags.pdf").read_bytes().decode("latin1")
    size, named = shapes(tmp_path / "tags-1.svg")
    boxes = [numbers(box) for box in re.findall(r"/MediaBox \[([^]]*)\]", data)]
    assert boxes == [pytest.approx([0.0, 0.0, 8.5 * 72, 11 * 72])] * 2
    filled = [
        numbers(re.sub(r"[mlh]\n", " ", path)) for path in re.findall(r"\n((?:[-\d. ]+ [ml]\n|h\n)+)\n*f\n", data)
    ]
    polygons = {tuple(np.round(path, 2)) for path in filled}
    for name in ("tag-0", "tag-3", "forward-1"):
        expected = np.concatenate(named[name])
        flipped = np.column_stack([expected[:, 0], size[1] - expected[:, 1]]) / MM_PER_PT
        assert any(np.allclose(flipped.ravel(), path, atol=0.02) for path in polygons if len(path) == flipped.size)


def test_same_command_same_file(tmp_path: Path) -> None:
    for suffix in ("svg", "pdf"):
        data = set()
        for _ in range(2):
            drawn("tags", "--ids", "9", "--out", tmp_path / f"tag.{suffix}")
            data.add((tmp_path / f"tag.{suffix}").read_bytes())
        assert len(data) == 1
        assert b"Date" not in data.pop()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("tags --ids 1,587 --out t.pdf", "--ids 1,587: '587' is not in 0-586"),
        ("tags --ids 5-3 --out t.pdf", "goes backwards"),
        ("tags --ids -3 --out t.pdf", "'-3' is neither an id nor a range"),
        ("tags --ids 1,,2 --out t.pdf", "'' is neither an id nor a range"),
        ("tags --ids 1-4,3 --out t.pdf", "3 is there twice"),
        ("tags --ids 1 --side-mm 300 --out t.pdf", "--side-mm 300: with its white rim 382 mm wide, too large for a4"),
        ("tags --ids 1 --side-mm nan --out t.pdf", "--side-mm nan: must be 5 mm or more"),
        ("tags --ids 1 --side-mm -70 --out t.pdf", "--side-mm -70: must be 5 mm or more"),
        ("tags --ids 1 --paper a9 --out t.pdf", "--paper a9: must be a4, a3"),
        ("tags --ids 1 --out t.png", "--out t.png: must end in .pdf or .svg"),
        ("tags --ids 1 --out {}/file/t.pdf", "--out {}/file/t.pdf: "),
        ("floor nothing.yaml --out t.pdf", "nothing.yaml:1:1: there is no such file"),
        (f"floor {ROOT}/configs/lab.yaml --out t.png", "--out t.png: must end in .pdf or .svg"),
        (f"floor {ROOT}/configs/lab.yaml --count 3 --out t.pdf", "--count 3: must be 4 to 8"),
        (f"floor {ROOT}/configs/lab.yaml --first-id 583 --out t.pdf", "--first-id 583: 8 free ids up to 586"),
        (f"floor {ROOT}/configs/lab.yaml --side-mm 900 --out t.pdf", "--side-mm 900: too large for an arena of 3.5"),
        ("board --marker-mm 40 --out t.pdf", "--marker-mm 40: must be smaller than its square of 40 mm"),
        ("board --squares 11x8 --out t.pdf", "--paper a3: too small for 11 x 8 squares of 40 mm; 9 x 6 fit"),
        ("board --squares 11 --out t.pdf", "--squares: '11' is not COLUMNSxROWS"),
        ("board --squares 2x9 --paper a0 --out t.pdf", "a board needs 3 x 3 or more"),
        ("board --square-mm 90 --out t.pdf", "a board needs 3 x 3 or more"),
        ("board --squares 40x30 --square-mm 20 --marker-mm 15 --paper a0 --out t.pdf", "more than 250 markers"),
    ],
)
def test_bad_input_is_one_line(arguments: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    done = run(*arguments.format(tmp_path).split())
    assert done.exit_code == 2
    assert says.format(tmp_path) in done.stderr
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
