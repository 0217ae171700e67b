"""Poses of AprilTags in a video, a folder of images or a camera's images, without a fleet and its configuration."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from robofleet.bus.messages import TagPose
from robofleet.config.calibrated import CameraModel
from robofleet.config.files.part import load_part
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import S
from robofleet.core.settings import FAMILIES, is_family
from robofleet.tracking.cameras.recorded import Recording, decoded
from robofleet.tracking.events import Notice
from robofleet.tracking.look import Lasting, Look, Taken
from robofleet.tracking.outlines import corners_of
from robofleet.tracking.plane import PlacedCamera
from robofleet.tracking.sources import Camera, CameraError
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker

_RECORDED, _LIVE = Lasting(10.0, 120.0), Lasting(3.0, 10.0)
_SIDES_M, _FOVS_DEG = (1e-3, 10.0), (10.0, 170.0)
_ANY_S = 1e9  # for which a tag may move unseen


class TrackedImage(NamedTuple):
    """The tags in one image.

    Attributes:
        t_s: Mid-exposure, since the first image [s].
        number: Of the image, from 0.
        name: Of its file; of a video's frame ``robots.mp4:frame 12``.
        image: Grey levels (H, W).
        poses: Each tag that was measured in it (``coasted_ns`` 0), or is predicted because it was hidden just now.
        happenings: Tags that were found, lost, seen twice.
    """

    t_s: float
    number: int
    name: str
    image: Image
    poses: tuple[TagPose, ...]
    happenings: tuple[Notice, ...]


class Tracks:
    """The poses of tags, image by image: iterate over it once.

    Attributes:
        camera: The camera, and how well its place is known.
        count: Images of the source; 0: not known.
        rate_hz: Images per second, on average; 0: not known.
        notes: What was assumed, and what looks wrong.
    """

    def __init__(
        self,
        camera: PlacedCamera,
        notes: tuple[str, ...],
        targets: Sequence[Target],
        images: Iterable[Taken],
        count: int = 0,
        rate_hz: float = 0.0,
    ) -> None:
        """Take what ``track`` found out."""
        self.camera, self.notes, self.count, self.rate_hz = camera, notes, count, rate_hz
        self._targets, self._images = {target.tag: target for target in targets}, images
        self._tracker = TagTracker(camera.geometry, camera.size, targets, camera.line_time_s)

    def __iter__(self) -> Iterator[TrackedImage]:
        """Yield the images with their poses.

        Raises:
            CameraError: An image cannot be read, or a video is truncated. All images before it were yielded.
        """
        first_ns: int | None = None
        for number, (name, taken_ns, image) in enumerate(self._images):
            first_ns = taken_ns if first_ns is None else first_ns
            seen, _, happenings = self._tracker.track(image, taken_ns - first_ns + S)  # 0 is never
            poses = tuple(TagPose(s.tag, s.after_ns, s.coasted_ns, s.x, s.y, s.psi, *s.covariance) for s in seen)
            yield TrackedImage((taken_ns - first_ns) / S, number, name, image, poses, happenings)

    def outlines(self, poses: Sequence[TagPose]) -> dict[int, Array]:
        """Return where the tags appear.

        Args:
            poses: Of a ``TrackedImage``.

        Returns:
            The corners (4, 2) [px] of each print, clockwise from its top left, by the tag's number.
        """
        return corners_of(self.camera.geometry, {p.tag: (p.x_m, p.y_m, p.psi_rad) for p in poses}, self._targets)


def track(
    source: str | Path | Camera, *, ids: Sequence[int], side_m: float, camera: str | Path | CameraModel | None = None,
    fov_deg: float | None = None, height_m: float = 0.0, family: str = "36h11", times: str | Path | None = None,
    rate_hz: float | None = None, max_speed_m_s: float = 2.0,
) -> Tracks:  # fmt: skip
    """Find the poses of tags that lie flat, all on one level, seen from above.

        for image in track("robots.mp4", ids=[1, 2, 3], side_m=0.07):
            for pose in image.poses:
                print(image.t_s, pose.tag, pose.x_m, pose.y_m, pose.psi_rad)

    With a calibrated camera and its place (``robofleet calibrate arena``) poses are in the frame of that laboratory.
    Else the camera's place above the tags is found in the first images by the tags' shapes: the origin lies below the
    image's middle, x to the image's right there, y up in it.

    Args:
        source: A video, a folder of images (sorted by the numbers in their names), an image, or an open camera.
        ids: The tags' numbers.
        side_m: Side of a tag's square [m]. It is the scale of all poses where the camera's place is not calibrated.
        camera: A file of ``robofleet calibrate``, or its model. None: lens and place are found by the tags.
        fov_deg: Horizontal field of view of a camera that was not calibrated [deg].
        height_m: Height of the tags above the floor [m], where the camera's place is calibrated.
        family: 36h11, 25h9, 16h5 or Standard41h12.
        times: CSV of the images' times (``robofleet/tracking/cameras/stamps.py``). None: the video's own; of a folder,
            the images' names in ns.
        rate_hz: Images per second, in place of all other times.
        max_speed_m_s: A tag that seems faster is not believed [m/s].

    Returns:
        The poses, image by image, and what is known of the camera.

    Raises:
        CameraError: The source cannot be read, an argument cannot be, or no tag was found. The message says what to
            mend.
    """
    faults = _faults(ids, side_m, fov_deg, family)
    if fov_deg is not None and camera is not None:
        faults.append("fov: the calibrated camera has one: leave it out")
    if faults:
        raise CameraError("\n".join(faults))
    assert is_family(family)
    model = camera if camera is None or isinstance(camera, CameraModel) else load_part(Path(camera), CameraModel)
    targets = [Target(tag, side_m, height_m, max_speed_m_s, family, _ANY_S) for tag in ids]
    if isinstance(source, str | Path):
        recording = Recording(Path(source), None if times is None else Path(times), rate_hz)
        look = Look(_recorded(recording), str(source), targets, model, _RECORDED)
        return Tracks(*look.camera(fov_deg), targets, _recorded(recording), recording.count, recording.rate_hz)
    images = _live(source)
    return Tracks(*Look(images, "the camera", targets, model, _LIVE).camera(fov_deg), targets, images)


def _faults(ids: Sequence[int], side_m: float, fov_deg: float | None, family: str) -> list[str]:
    """Return what is wrong with the arguments of ``track``."""
    if not is_family(family):
        return [f"family: {family!r} is not known: take one of {', '.join(FAMILIES)}"]
    last = FAMILIES[family].ids - 1
    faults = [f"ids: {tag}: the family {family} has the ids 0 to {last}" for tag in ids if not 0 <= tag <= last]
    if not ids or len(set(ids)) < len(ids):
        faults.append("ids: name one tag or more, and each once")
    if not _SIDES_M[0] <= side_m <= _SIDES_M[1]:
        faults.append(f"side: {1e3 * side_m:g} mm is not between {1e3 * _SIDES_M[0]:g} and {1e3 * _SIDES_M[1]:g} mm")
    if fov_deg is not None and not _FOVS_DEG[0] <= fov_deg <= _FOVS_DEG[1]:
        faults.append(
            f"fov: {fov_deg:g} degrees is not between {_FOVS_DEG[0]:g} and {_FOVS_DEG[1]:g}: it is horizontal"
        )
    return faults


def _recorded(recording: Recording) -> Iterator[Taken]:
    for shot, image in decoded(recording.path, recording.shots()):
        yield Taken(shot.name, shot.taken_ns, image)


def _live(camera: Camera) -> Iterator[Taken]:
    with suppress(EOFError):
        for number in itertools.count():
            frame = camera.read()
            yield Taken(f"image {number}", frame.exposure_ns, frame.image)
