"""A first look at images: where the camera is, whether the tags are of the size that is said, and what else is seen."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Image
from robofleet.core.clock import S
from robofleet.core.settings import FAMILIES, is_family
from robofleet.tracking import plane
from robofleet.tracking.cameras.recorded import size
from robofleet.tracking.plane import PlacedCamera, SeenTags
from robofleet.tracking.sources import CameraError
from robofleet.tracking.tags.finder import TagFinder
from robofleet.tracking.tags.instead import instead
from robofleet.tracking.tags.targets import Target

_EVERY_NS = S // 2  # between images that are looked at
_ENOUGH = 80  # tags, each in another place, that tell where the camera is,
_FEW = 5  # and by which a calibrated place is compared with their side
_MISSED = 3  # images without a tag in which others are sought
_SIDE_OFF = 0.02  # share of its side by which a tag may seem larger or smaller
_SIDE_RATIO = (0.8, 1.25)  # beyond, the tracker takes it for none
_UNSURE_M = 0.02  # at the image's edge


class Taken(NamedTuple):
    """An image, and when it was taken [ns]."""

    name: str
    taken_ns: int
    image: Image


class Lasting(NamedTuple):
    """How long to look."""

    seen_s: float  # from the first image on that shows a tag
    unseen_s: float  # until that


class Look:
    """What the first images show."""

    def __init__(
        self, images: Iterator[Taken], name: str, targets: Sequence[Target], model: CameraModel | None, lasting: Lasting
    ) -> None:
        """Look at images of a source of that name.

        Raises:
            CameraError: The first image cannot be read, or has another size than the calibrated camera's.
        """
        first = targets[0]
        assert is_family(first.family)
        self._name, self._targets, self._model, self._family = name, targets, model, first.family
        self._seen, self._missed = SeenTags(), list[Image]()
        self._finder = TagFinder(first.family, [target.tag for target in targets])
        next_ns = end_ns = 0
        for image in _readable(images):
            if not end_ns:
                self._size = self._fitting(image.image)
                next_ns, end_ns = image.taken_ns, image.taken_ns + round(lasting.unseen_s * S)
            if image.taken_ns < next_ns:
                continue
            next_ns = image.taken_ns + _EVERY_NS
            before = len(self._seen)
            self._take(image.image)
            if len(self._seen) and not before:
                end_ns = image.taken_ns + round(lasting.seen_s * S)
            if image.taken_ns >= end_ns or len(self._seen) >= (_FEW if self._whole else _ENOUGH):
                break

    def camera(self, fov_deg: float | None) -> tuple[PlacedCamera, tuple[str, ...]]:
        """Return the camera, and notes about it.

        fov_deg: horizontal field of view of a lens that was not calibrated; None: it is not known.

        Raises:
            CameraError: No tag is seen, or the tags cannot be of their size.
        """
        first = self._targets[0]
        if not len(self._seen):
            ids = [target.tag for target in self._targets]
            raise CameraError(f"{self._name}: {instead(self._missed, ids, self._family)}")
        if self._model is None or not self._whole:
            camera = plane.placed(self._seen.corners, first.side, first.height, self._size, self._model, fov_deg)
            return camera, (_uncalibrated(camera, first.height, named=fov_deg is not None),)
        camera = plane.calibrated(self._model)
        ratio = plane.side_ratio(camera.geometry, self._seen.corners, first.side, first.height)
        if abs(ratio - 1.0) < _SIDE_OFF:
            return camera, ()
        wrong = (
            f"{self._name}: the tags' side seems to be {1e3 * ratio * first.side:.1f} mm, not {1e3 * first.side:g} mm: "
            f"measure the {FAMILIES[first.family].named} and the tags' height above the floor "
            f"({1e3 * first.height:g} mm), or calibrate the camera's place again"
        )
        if not _SIDE_RATIO[0] < ratio < _SIDE_RATIO[1]:
            raise CameraError(wrong)
        return camera, (wrong,)

    @property
    def _whole(self) -> bool:
        """Whether the camera's place was measured too."""
        return self._model is not None and self._model.T_world_camera is not None

    def _fitting(self, image: Image) -> tuple[int, int]:
        """Return width and height of an image; CameraError unless they are the calibrated camera's."""
        model = self._model
        if model is not None and image.shape != (model.height, model.width):
            raise CameraError(
                f"{self._name}: {size(image)}, but the camera is calibrated for {model.width} x {model.height}: "
                "take images of that size, or calibrate the lens for this one"
            )
        return image.shape[1], image.shape[0]

    def _take(self, image: Image) -> None:
        for tag, prints in self._finder.find(image).items():
            if len(prints) == 1:
                self._seen.add(tag, prints[0].corners)
        if not len(self._seen) and len(self._missed) < _MISSED:
            self._missed.append(image.copy())


def _readable(images: Iterator[Taken]) -> Iterator[Taken]:
    """Yield images up to one that cannot be read, if there is one before: who tracks them will come to it again."""
    some = False
    try:
        for image in images:
            yield image
            some = True
    except CameraError:
        if not some:
            raise


def _uncalibrated(camera: PlacedCamera, height_m: float, *, named: bool) -> str:
    """Return what was assumed of a camera above tags of a height, and what that costs."""
    fov = f"its horizontal field of view, {camera.fov_deg:.0f} degrees, is {'the one named' if named else 'estimated'}"
    lens = "" if camera.lens_calibrated else f"The lens is not calibrated: {fov}, and so is its distortion. "
    unsure = ": few tags tell it, more of them or one that moves about tell more" * (camera.edge_error_m > _UNSURE_M)
    return (
        f"camera: by the tags' shapes {camera.height_m - height_m:.2f} m above them, tilted by "
        f"{camera.tilt_deg:.0f} degrees. x, y = 0 lies below the image's middle, x to the image's right there, y up. "
        f"{lens}Positions may be off by {_mm(camera.edge_error_m)} at the image's edge, less inside{unsure}. All "
        "lengths are as right as the tags' side. `robofleet calibrate` measures a lens, and a place in a laboratory"
    )


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.1f} mm" if length_m < 0.01 else f"{1e3 * length_m:.0f} mm"
