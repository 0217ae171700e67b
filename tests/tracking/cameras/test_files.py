"""Videos and folders of images as a camera: written by OpenCV, cut, mixed up and wrongly stamped."""

import os
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, SimulatedClock, WallClock
from robofleet.testing import CameraContract
from robofleet.tracking.cameras.files import FileCamera
from robofleet.tracking.cameras.recorded import Recording, images
from robofleet.tracking.sources import CameraError, ScheduledCamera
from tests.contexts import context
from tests.shipped import PLATOON

SIZE = (64, 48)  # width, height
STAMPS_NS = [1_714_000_000_123_456_789 + k * 33_333_333 for k in range(8)]


def gray(k: int, size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    """Return an image that tells its number, with noise that takes room in a file."""
    return (10 + 20 * k + np.random.default_rng(k).integers(-8, 9, size[::-1])).astype(np.uint8)


def number(image: NDArray[np.uint8]) -> int:
    """Return which image this is, also after a video's compression."""
    return round((float(image.mean()) - 10) / 20)


def folder(path: Path, names: Sequence[str]) -> Path:
    path.mkdir()
    for k, name in enumerate(names):
        assert cv2.imwrite(str(path / name), gray(k))
    return path


def video(path: Path, frames: int = 8, *, color: bool = True) -> Path:
    codec = {".avi": "MJPG", ".mp4": "mp4v", ".mkv": "FFV1"}[path.suffix]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 30.0, SIZE, color)
    assert writer.isOpened()
    for k in range(frames):
        writer.write(cv2.merge([gray(k)] * 3) if color else gray(k))
    writer.release()
    return path


def bomb(path: Path) -> Path:
    """Write 54 bytes that claim to be an image of 60000 x 60000 px."""
    path.mkdir()
    header = struct.pack("<2sIIIIiiHHIIIIII", b"BM", 54, 0, 54, 40, 60_000, 60_000, 1, 24, 0, 0, 0, 0, 0, 0)
    (path / "0.bmp").write_bytes(header)
    return path


def cut(path: Path, share: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def csv(path: Path, header: str, lines: Sequence[object]) -> Path:
    path.write_text("\n".join([header, *map(str, lines)]) + "\n")
    return path


def config(path: Path, stamps: Path | None = None, *overrides: str) -> Config:
    size = [
        f"camera.{part}{key}={n}" for key, n in zip(("width", "height"), SIZE, strict=True) for part in ("", "model.")
    ]
    named = f"camera.files={{path: '{path}'" + (f", stamps: '{stamps}'}}" if stamps else "}")
    return load_config(PLATOON, [*size, "camera.source=files", "camera.trigger=free", named, *overrides])


def camera_of(tree: Config, clock: SimulatedClock | WallClock, extra_delay_ns: int = 0) -> FileCamera:
    """Return the camera of a run that has begun."""
    around = context(tree, clock, extra_delay_ns=extra_delay_ns)
    around.ticks.newest = 1
    return FileCamera(around)


def refused(read: Callable[[], object]) -> str:
    with pytest.raises(CameraError) as error:
        read()
    return str(error.value)


# images()


@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.mkv"])
@pytest.mark.parametrize("color", [True, False])
def test_every_frame_of_a_video_comes_gray_and_in_order(tmp_path: Path, name: str, color: bool) -> None:
    seen = list(images(video(tmp_path / name, color=color)))
    assert [entry for entry, _ in seen] == [f"{name}:frame {k}" for k in range(8)]
    assert [number(image) for _, image in seen] == list(range(8))
    assert {(image.shape, image.dtype) for _, image in seen} == {(SIZE[::-1], np.dtype(np.uint8))}


def test_images_of_a_folder_come_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    names = ["shot2.png", "shot10.jpg", "shot11.PNG", "shot100.bmp"]
    path = folder(tmp_path / "shots", names)
    (path / "notes.txt").write_text("no image")
    (path / "._shot1.png").write_bytes(b"no image either")
    assert [(name, number(image)) for name, image in images(path)] == list(zip(names, range(4), strict=True))


def test_an_image_comes_as_the_sensor_took_it(tmp_path: Path) -> None:
    """Pixels are calibrated as they are on the sensor, whichever way up a viewer would show them."""
    path = folder(tmp_path / "shots", ["0.jpg"])
    jpeg = (path / "0.jpg").read_bytes()
    turned = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"  # orientation: 6
    (path / "0.jpg").write_bytes(jpeg[:2] + b"\xff\xe1" + (len(turned) + 2).to_bytes(2, "big") + turned + jpeg[2:])
    assert cv2.imread(str(path / "0.jpg"), cv2.IMREAD_GRAYSCALE).shape == SIZE, "a viewer turns it"
    ((_, image),) = images(path)
    assert image.shape == SIZE[::-1]


@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.mkv"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9])
def test_a_truncated_video_is_refused_where_it_ends(tmp_path: Path, name: str, share: float) -> None:
    path = cut(video(tmp_path / name, color=True), share)
    seen = []

    def read() -> None:
        seen.extend(entry for entry, _ in images(path))

    assert refused(read).startswith(f"{path}:frame {len(seen)}: " if seen else str(path))
    assert len(seen) < 8


@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.mkv"])
def test_a_video_without_a_frame_is_refused(tmp_path: Path, name: str) -> None:
    path = video(tmp_path / name, 0)
    assert refused(lambda: list(images(path))).startswith(str(path))


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda path: path / "none.avi", "none.avi: No such file or directory"),
        (lambda path: csv(path / "text.avi", "no", ["video"]), "text.avi: cannot be read as a video"),
        (lambda path: folder(path / "empty", []), "empty: there is no image"),
        (lambda path: path / ("a" * 300), "a" * 300 + ": File name too long"),
        (lambda path: path / "a\0", "a\0: embedded null"),
        (lambda path: bomb(path / "bomb"), "bomb/0.bmp: cannot be read as an image"),
    ],
)
def test_what_is_no_images_is_refused_by_name(tmp_path: Path, make: Callable[[Path], Path], where: str) -> None:
    path = make(tmp_path)
    assert refused(lambda: next(images(path))).startswith(str(tmp_path / where))


def test_a_name_that_would_crash_opencv_is_refused(tmp_path: Path) -> None:
    path = folder(tmp_path / "shots", ["0.png"])
    (path / "0.png").rename(path / os.fsdecode(b"\xff.png"))
    assert refused(lambda: next(images(path))).endswith(r"shots/\udcff.png': this name is not in UTF-8: rename it")
    moved = video(tmp_path / "a.avi").rename(tmp_path / os.fsdecode(b"\xff.avi"))
    assert refused(lambda: next(images(moved))).endswith("this name is not in UTF-8: rename it")


def test_an_image_that_is_none_or_of_another_size_is_refused_by_name(tmp_path: Path) -> None:
    path = folder(tmp_path / "shots", ["0.png", "1.png"])
    cv2.imwrite(str(path / "2.png"), gray(2, (32, 48)))
    assert refused(lambda: list(images(path))) == (f"{path / '2.png'}: 32 x 48 px, but the first image has 64 x 48 px")
    cut(path / "1.png", 0.3)
    assert refused(lambda: list(images(path))) == f"{path / '1.png'}: cannot be read as an image"


# The camera


@pytest.fixture(params=["names", "folder", "video"])
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Config:
    """Return eight images of a recording, stamped in each of the ways that there are."""
    match request.param:
        case "names":
            return config(folder(tmp_path / "shots", [f"{stamp}.png" for stamp in STAMPS_NS]))
        case "folder":
            names = [f"shot-{8 - k}.png" for k in range(8)]
            lines = [f"{name},{stamp}" for name, stamp in zip(names, STAMPS_NS, strict=True)]
            stamps = csv(tmp_path / "stamps.csv", "file,exposure_ns", lines)
            return config(folder(tmp_path / "shots", names), stamps)
        case _:
            lines = [f"{stamp // S}.{stamp % S:09d}" for stamp in STAMPS_NS]
            return config(video(tmp_path / "a.avi"), csv(tmp_path / "stamps.csv", "exposure_s", lines))


def test_a_recording_is_shown_at_its_pace_on_this_hosts_clock(recorded: Config) -> None:
    assert list(FileCamera.refusals(recorded)) == []
    clock = SimulatedClock()
    clock.advance_to(5 * S)
    camera = camera_of(recorded, clock, 2 * MS)
    assert isinstance(camera, ScheduledCamera), "no thread is needed"
    assert camera.identity == Path(recorded.camera.files.path).name
    after_ns = round((recorded.camera.exposure_s / 2 + recorded.camera.readout_s) * S) + 2 * MS
    for k, stamp in enumerate(STAMPS_NS):
        exposure_ns = 5 * S + stamp - STAMPS_NS[0]
        assert camera.ready_ns() == exposure_ns + after_ns
        clock.advance_to(camera.ready_ns())
        frame = camera.read()
        assert (number(frame.image), frame.exposure_ns) == (k, exposure_ns)
    clock.advance_to(camera.ready_ns())
    for _ in range(2):
        with pytest.raises(EOFError, match="all of its 8 images"):
            camera.read()


class TestContract(CameraContract):
    shape = SIZE[::-1]

    @pytest.fixture
    def camera(self, recorded: Config) -> FileCamera:
        return camera_of(recorded, WallClock())


def test_images_that_nobody_is_in_time_for_are_dropped(recorded: Config) -> None:
    clock = SimulatedClock()
    camera = camera_of(recorded, clock)
    assert camera.ready_ns() is not None
    clock.advance_to(110 * MS)
    frame = camera.read()
    assert number(frame.image) == 3
    assert frame.exposure_ns == STAMPS_NS[3] - STAMPS_NS[0]
    clock.advance_to(camera.ready_ns())
    assert number(camera.read().image) == 4


@pytest.mark.parametrize(("rate_hz", "period_ns"), [(None, S // 30), (10.0, S // 10)])
@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.mkv"])
def test_a_video_has_times_of_its_own_unless_a_rate_is_named(
    tmp_path: Path, name: str, rate_hz: float | None, period_ns: int
) -> None:
    shots = Recording(video(tmp_path / name), rate_hz=rate_hz).shots()
    assert np.diff([shot.taken_ns for shot in shots]) == pytest.approx(7 * [period_ns], abs=MS)


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_a_video_whose_rate_varies_keeps_its_times(tmp_path: Path, name: str) -> None:
    times_ms = [0, 40, 80, 400, 440, 1200, 1250]
    with av.open(str(tmp_path / name), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height = SIZE
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for k, time_ms in enumerate(times_ms):
            frame = av.VideoFrame.from_ndarray(gray(k), "gray")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    shots = list(Recording(tmp_path / name).shots())
    assert [shot.taken_ns / MS for shot in shots] == pytest.approx(times_ms, abs=1.0)


def test_a_recording_begins_with_the_runs_first_tick(recorded: Config) -> None:
    clock = SimulatedClock()
    around = context(recorded, clock)
    camera = FileCamera(around)
    clock.advance_to(20 * S)
    assert camera.ready_ns() is None
    around.ticks.newest = 1
    ready_ns = camera.ready_ns()
    assert ready_ns is not None
    clock.advance_to(ready_ns)
    frame = camera.read()
    assert (number(frame.image), frame.exposure_ns) == (0, 20 * S)


def test_a_video_that_breaks_off_ends_and_says_where(tmp_path: Path) -> None:
    path = video(tmp_path / "a.avi")
    stamps = csv(tmp_path / "stamps.csv", "exposure_ns", STAMPS_NS)
    cut(path, 0.6)
    clock = SimulatedClock()
    camera = camera_of(config(path, stamps), clock)
    with pytest.raises(EOFError, match=r"a\.avi:frame \d: cannot be read: the video is truncated"):
        for _ in range(9):
            clock.advance_to(camera.ready_ns())
            camera.read()


# Stamps


@pytest.mark.parametrize(
    ("header", "lines", "line", "why"),
    [
        ("exposure_ns", STAMPS_NS[:5], 7, "no line for"),
        ("exposure_ns", [*STAMPS_NS, STAMPS_NS[-1] + 1], 10, "is for frame 8"),
        ("exposure_ns", [*STAMPS_NS[:4], STAMPS_NS[3], *STAMPS_NS[5:]], 6, "is not later"),
        ("exposure_ns", [*STAMPS_NS[:4], 17, *STAMPS_NS[5:]], 6, "is not later"),
        ("exposure_ns", [*STAMPS_NS[:2], "soon", *STAMPS_NS[3:]], 4, "'soon' is not a time"),
        ("exposure_ns", [*STAMPS_NS[:2], "nan", *STAMPS_NS[3:]], 4, "'nan' is not a time"),
        ("exposure_ns", [*STAMPS_NS[:2], "-inf", *STAMPS_NS[3:]], 4, "'-inf' is not a time"),
        ("exposure_ns", [*STAMPS_NS[:2], "1e999999999", *STAMPS_NS[3:]], 4, "is not a time"),
        ("exposure_s", [1, 2, "1e999999999999999999", 4, 5, 6, 7, 8], 4, "is not a time"),
        ("exposure_ns", [*STAMPS_NS[:2], "", *STAMPS_NS[3:]], 4, "0 columns, must be 1"),
        ("exposure_ns", [*STAMPS_NS[:2], f"{STAMPS_NS[2]},1", *STAMPS_NS[3:]], 4, "2 columns, must be 1"),
        ("exposure", STAMPS_NS, 1, "must be 'exposure_ns' or 'exposure_s'"),
        (str(STAMPS_NS[0]), STAMPS_NS[1:], 1, "must be 'exposure_ns' or 'exposure_s'"),
        ("file,exposure_ns", STAMPS_NS, 1, "must be 'exposure_ns' or 'exposure_s'"),
        ("", [], 1, "must be 'exposure_ns' or 'exposure_s'"),
        ("exposure_ns", [], 2, "there is no line"),
    ],
)
def test_a_wrong_stamp_of_a_video_is_refused_with_its_line(
    tmp_path: Path, header: str, lines: list[object], line: int, why: str
) -> None:
    stamps = csv(tmp_path / "stamps.csv", header, lines)
    tree = config(video(tmp_path / "a.avi"), stamps)
    message = refused(lambda: camera_of(tree, SimulatedClock()))
    assert message.startswith(f"{stamps}:{line}: ")
    assert why in message
    assert list(FileCamera.refusals(tree)) == [("camera.files", message)]


@pytest.mark.parametrize("data", [b"", b"exposure_ns\n\xff\xfe\n", b'exposure_ns\n"1\n', b"exposure_ns\n1\0\n"])
def test_stamps_that_are_no_csv(tmp_path: Path, data: bytes) -> None:
    stamps = tmp_path / "stamps.csv"
    stamps.write_bytes(data)
    tree = config(video(tmp_path / "a.avi"), stamps)
    assert refused(lambda: camera_of(tree, SimulatedClock())).startswith(str(stamps))


def test_stamps_may_come_from_a_spreadsheet(tmp_path: Path) -> None:
    stamps = tmp_path / "stamps.csv"
    stamps.write_bytes(b"\xef\xbb\xbfexposure_s\r\n" + b"".join(b'"%d.5"\r\n' % k for k in range(8)))
    clock = SimulatedClock()
    camera = camera_of(config(video(tmp_path / "a.avi"), stamps), clock)
    exposures = []
    for _ in range(8):
        clock.advance_to(camera.ready_ns())
        exposures.append(camera.read().exposure_ns)
    assert exposures == [k * S for k in range(8)]


def test_stamps_that_are_not_there(tmp_path: Path) -> None:
    path = video(tmp_path / "a.avi")
    missing = tmp_path / "none.csv"
    assert refused(lambda: camera_of(config(path, missing), SimulatedClock())).startswith(f"{missing}: No such file")
    ((where, _),) = FileCamera.refusals(load_config(PLATOON, ["camera.source=files", "camera.trigger=free"]))
    assert where == "camera.files"


def test_stamps_of_a_folder_name_each_image_once(tmp_path: Path) -> None:
    path = folder(tmp_path / "shots", ["a.png", "b.png", "c.png"])

    def why(*lines: str) -> str:
        stamps = csv(tmp_path / "stamps.csv", "file,exposure_ns", lines)
        return refused(lambda: camera_of(config(path, stamps), SimulatedClock()))

    stamps = tmp_path / "stamps.csv"
    assert why("a.png,1", "b.png,2") == f"{path / 'c.png'}: has no line in the CSV of stamps"
    assert why("a.png,1", "b.png,2", "c.png,3", "d.png,4") == f"{stamps}:5: there is no image {path / 'd.png'}"
    assert why("a.png,1", "b.png,2", "b.png,3", "c.png,4") == f"{stamps}:4: b.png has a line already"
    assert why("a.png,1", "b.png,3", "c.png,2").startswith(f"{stamps}:4: is not later")


def test_names_that_are_no_times(tmp_path: Path) -> None:
    path = folder(tmp_path / "shots", ["1.png", "2.png", "last.png"])
    message = refused(lambda: camera_of(config(path), SimulatedClock()))
    assert message.startswith(f"{path / 'last.png'}: this name is not a time in ns")
    (path / "last.png").rename(path / "02.png")
    message = refused(lambda: camera_of(config(path), SimulatedClock()))
    assert message.endswith("is not later than the one before: sort the lines by time")


# robofleet check


def test_a_file_that_cannot_work_is_refused_before_anything_starts(tmp_path: Path) -> None:
    path = folder(tmp_path / "shots", [f"{stamp}.png" for stamp in STAMPS_NS])
    tree = config(path, None, "camera.trigger=tick", "camera.width=32", "camera.model.width=32")
    complaints = dict(FileCamera.refusals(tree))
    assert set(complaints) == {"camera.trigger", "camera.files.path"}
    assert "64 x 48 px, but camera has 32 x 48" in complaints["camera.files.path"]
    ((where, why),) = FileCamera.refusals(config(tmp_path / "none"))
    assert where == "camera.files"
    assert str(tmp_path / "none") in why
