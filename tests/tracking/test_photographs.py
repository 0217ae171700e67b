"""Tags of 36h11 on photographs whose tags are listed: each, laid flat by its listed corners, is found and is no other.

ROBOFLEET_PHOTOGRAPHS names a folder of NAME.jpg and NAME.txt, with a line ``id, (u v), (u v), (u v), (u v)`` a tag, as
the folder test/data of github.com/AprilRobotics/apriltag has them (their corners go round to the left).
"""

import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.deep import DeepSearch
from robofleet.tracking.photometric import PhotometricFit
from robofleet.tracking.tags import TagDetector
from robofleet.tracking.targets import Target

FOLDER = os.environ.get("ROBOFLEET_PHOTOGRAPHS")
OTHERS = range(30)
M_A_PX = 0.002  # of the plane onto which a tag is laid


@pytest.mark.skipif(FOLDER is None, reason="ROBOFLEET_PHOTOGRAPHS names no folder of photographs")
def test_listed_tags_are_found_and_no_others() -> None:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 1000.0 * M_A_PX
    listed = found = wrong = 0
    for file in sorted(Path(str(FOLDER)).glob("*.txt")):
        photograph = cv2.imread(str(file.with_suffix(".jpg")), cv2.IMREAD_GRAYSCALE)
        assert photograph is not None, file
        for line in filter(str.strip, file.read_text().splitlines()):
            tag, *numbers = (float(number) for number in re.findall(r"[-\d.]+", line))
            corners = np.array(numbers).reshape(4, 2)[::-1].astype(np.float32)
            side = max(24.0, float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()))
            onto = 1.5 * side + side / 2.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            warp = cv2.getPerspectiveTransform(corners, onto.astype(np.float32))
            size = (int(3.0 * side), int(3.0 * side))
            image = np.asarray(cv2.warpPerspective(photograph, warp, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)
            K = [[1000.0, 0.0, 1.5 * side], [0.0, 1000.0, 1.5 * side], [0.0, 0.0, 1.0]]
            targets = [Target(each, side * M_A_PX, 0.0, 0.2) for each in sorted({int(tag), *OTHERS})]
            fit = PhotometricFit(CameraGeometry(K, [0.0] * 5, T), targets)
            tags = [tag for way in (TagDetector, DeepSearch) for tag in way(fit, targets).detect(image).tags]
            ids = {targets[seen.target].tag for seen in tags if abs(seen.centre) < side * M_A_PX / 2.0}
            listed, found, wrong = listed + 1, found + (int(tag) in ids), wrong + len(ids - {int(tag)})
    print(f"{found} of {listed} tags, {wrong} wrong")
    assert wrong == 0
    assert found >= 0.95 * listed > 0
