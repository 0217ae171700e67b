"""Tags on photographs of public repositories: who finds those that are listed, and says what is not there.

    python -m tools.measure.tracking.photographs FOLDER

FOLDER/OWNER/REPOSITORY is a clone of each repository in ``photographs.txt``; what is not there is left out. Libraries
read each photograph as it is. Robofleet knows where its camera hangs and how high its tags lie: so each tag is laid
flat by its listed corners, up to 0.4 sides aside, and searched there with forty ids that the fleet could have; and as
many places beside the tags are searched, which show none. Nothing is enlarged. Rows by a tag's side in the photograph;
columns: listed tags that are found; what else is said.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pyapriltags

from robofleet.core.arrays import Array, Image
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.deep import DeepSearch
from robofleet.tracking.tags.detection import TagDetector
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from tests.tracking.peers import OURS
from tools.measure.program import program

APRILTAG = "pyapriltags, decimate 1"
OTHERS = range(40)
_LIST = Path(__file__).with_suffix(".txt")
_M_A_PX = 0.002  # of the plane onto which a tag is laid
_SIDES_PX = (0, 14, 20, 30)  # from which a row counts


class Listed(NamedTuple):
    tag: int
    corners: Array  # (4, 2) [px]


class Photograph(NamedTuple):
    file: str
    tags: list[Listed]


Detect = Callable[[Image], list[Listed]]


def listed() -> Iterator[Photograph]:
    file, tags = "", list[Listed]()
    for line in _LIST.read_text(encoding="ascii").splitlines():
        if line.startswith(" "):
            tag, *numbers = line.split()
            tags.append(Listed(int(tag), np.array(numbers, np.float64).reshape(4, 2)))
        elif not line.startswith("#"):
            if tags:
                yield Photograph(file, tags)
            file, tags = line, []
    yield Photograph(file, tags)


def found(folder: Path) -> dict[str, dict[str, Counter[str]]]:
    """Return by sides and candidates how many tags are ``listed``, ``found`` and ``wrong``."""
    peers, tables = _peers(), dict[str, dict[str, Counter[str]]]()
    for photograph in listed():
        image = cv2.imread(str(folder / photograph.file), cv2.IMREAD_GRAYSCALE)
        if image is None:
            continue
        for name, detect in peers.items():
            for size, row in _judged(photograph.tags, detect(np.asarray(image, np.uint8))):
                tables.setdefault(size, {}).setdefault(name, Counter()).update(row)
        for size, row in _ours(photograph, np.asarray(image, np.uint8)):
            tables.setdefault(size, {}).setdefault(OURS, Counter()).update(row)
    return {size: tables[size] for size in sorted(tables)}


def _size(corners: Array) -> str:
    """Return the row of a tag with these corners."""
    least = max(least for least in _SIDES_PX if least <= _side(corners))
    return f"from {least:>2} px"


def _side(corners: Array) -> float:
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())


def _judged(tags: list[Listed], seen: list[Listed]) -> Iterator[tuple[str, dict[str, int]]]:
    """Yield sizes, and what a candidate's tags are."""
    for tag in tags:
        yield _size(tag.corners), {"listed": 1, "found": int(any(_are_same(tag, found_tag) for found_tag in seen))}
    for found_tag in seen:
        yield _size(found_tag.corners), {"wrong": int(not any(_are_same(tag, found_tag) for tag in tags))}


def _are_same(first: Listed, other: Listed) -> bool:
    apart = np.linalg.norm(first.corners.mean(0) - other.corners.mean(0))
    return first.tag == other.tag and bool(apart < 0.5 * np.linalg.norm(first.corners[0] - first.corners[1]))


def _ours(photograph: Photograph, image: Image) -> Iterator[tuple[str, dict[str, int]]]:
    rng = np.random.default_rng(len(photograph.file))
    expected = {tag.tag for tag in photograph.tags}
    for tag, corners in photograph.tags:
        aside = rng.uniform(-0.4, 0.4, 2)
        seen = _laid_flat(image, corners, aside, [tag, *OTHERS])
        right = any(seen_tag == tag and np.abs(at - aside).max() < 0.25 for seen_tag, at in seen)
        wrong = sum(
            seen_tag not in expected or (seen_tag != tag and np.abs(at - aside).max() < 0.5) for seen_tag, at in seen
        )
        yield _size(corners), {"listed": 1, "found": int(right), "wrong": wrong}
        elsewhere = corners - corners.mean(0) + rng.uniform((0, 0), image.shape[::-1])
        size = 2.0 * float(np.ptp(corners, axis=0).max())
        if all(np.linalg.norm(seen_tag.corners.mean(0) - elsewhere.mean(0)) > size for seen_tag in photograph.tags):
            strangers = set(OTHERS) - expected  # a listed tag may be at the rim of what is searched
            yield _size(corners), {"wrong": len(_laid_flat(image, elsewhere, np.zeros(2), sorted(strangers)))}


def _laid_flat(image: Image, corners: Array, aside: Array, ids: list[int]) -> list[tuple[int, Array]]:
    """Return what both searches find around a square that is laid flat, and where: from the middle [sides]."""
    side = _side(corners)
    middle, size = 1.5 * side, int(3.0 * side)
    onto = middle + side * (aside + np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]))
    warp = cv2.getPerspectiveTransform(corners.astype(np.float32), onto.astype(np.float32))
    flat = np.asarray(cv2.warpPerspective(image, warp, (size, size), borderMode=cv2.BORDER_REPLICATE), np.uint8)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 1000.0 * _M_A_PX
    geometry = CameraGeometry([[1000.0, 0.0, middle], [0.0, 1000.0, middle], [0.0, 0.0, 1.0]], [0.0] * 5, down)
    targets = [Target(tag, side * _M_A_PX, 0.0, 0.2) for tag in sorted(set(ids))]
    fit = PhotometricFit(geometry, targets)
    tags = [tag for search in (TagDetector, DeepSearch) for tag in search(fit, targets).detect(flat).tags]
    at = [np.array([tag.centre.real, -tag.centre.imag]) / (side * _M_A_PX) for tag in tags]
    return [(targets[tag.target].tag, where) for tag, where in zip(tags, at, strict=True)]


def _peers() -> dict[str, Detect]:
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tuned = cv2.aruco.DetectorParameters()  # as peers.py has it, for tags of any size
    tuned.adaptiveThreshWinSizeMin = tuned.adaptiveThreshWinSizeMax = 13
    tuned.adaptiveThreshConstant, tuned.minMarkerPerimeterRate = 15.0, 0.01
    tuned.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    library = pyapriltags.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
    return {
        APRILTAG: lambda image: [Listed(tag.tag_id, tag.corners - 0.5) for tag in library.detect(image)],
        "OpenCV, default": _opencv(cv2.aruco.ArucoDetector(family)),
        "OpenCV, tuned": _opencv(cv2.aruco.ArucoDetector(family, tuned)),
    }


def _opencv(detector: cv2.aruco.ArucoDetector) -> Detect:
    def detect(image: Image) -> list[Listed]:
        corners, ids, _ = detector.detectMarkers(image)
        tags = [] if ids is None else ids.ravel().tolist()
        return [Listed(int(tag), np.asarray(quad[0], np.float64)) for tag, quad in zip(tags, corners, strict=True)]

    return detect


def main() -> None:
    parser = program(__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    cv2.setNumThreads(1)
    tables, total = found(folder), dict[str, Counter[str]]()
    if not tables:
        parser.error(f"{folder} has none of the files in {_LIST}: clone its repositories to {folder}/OWNER/REPOSITORY")
    print(f"{'side':<12}{'':<26}{'listed':>8}{'found':>8}{'wrong':>8}")
    for table in tables.values():
        for name, row in table.items():
            total.setdefault(name, Counter()).update(row)
    for size, table in {**tables, "all": total}.items():
        for name, row in table.items():
            print(f"{size:<12}{name:<26}{row['listed']:>8}{row['found']:>8}{row['wrong']:>8}")


if __name__ == "__main__":
    main()
