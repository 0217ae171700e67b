"""A camera's lens from views of a board: fitted, tested, and refused where the views do not determine it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from robofleet.calibration.lens.board import Board, BoardView
from robofleet.calibration.lens.bundle import Fit, fit, typical
from robofleet.calibration.lens.floor import Ceiling, FloorErrors
from robofleet.calibration.lens.views import Coverage, Wanted, next_view
from robofleet.calibration.store import CalibrationError, provenance
from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Array
from robofleet.tracking.camera import Lens as Kind

COEFFICIENTS: dict[Kind, tuple[int, ...]] = {"pinhole": (4, 5, 8, 12, 14), "fisheye": (4,)}  # OpenCV's models
VIEWS = 12  # at least: fewer leave too little to compare
ARENA_MM = 0.5  # uncertainty of a place, rms over the arena, after the pose is fitted to floor tags
FOCAL = 0.005  # standard deviation of a focal length, relative
NOISE_PX = 1.0  # of a corner's coordinate: more is another board, or another kind of lens
OUTLIERS = 1 / 3  # of the views: more are not outliers
_PULL = 5.0  # of a view on the lens (``Fit.surprise``): noise hardly ever does that
_PULL_RATIO = 6.0  # over the median view's: a lens that the model does not quite fit surprises everywhere
_HOPELESS = "no lens explains the views: is the board another one?"
_HOPELESS_PX = 20.0
_FOLDS = 5
_NAMED_VIEWS = 3  # those that contradict the others most
_SHARED = 2.0  # what leaving out views tells over what noise tells: beyond it the views share errors


class Conditions(NamedTuple):
    """What is measured, with what, and for which ceiling."""

    board: Board
    kind: Kind
    coefficients: int
    size: tuple[int, int]  # of the images, width and height [px]
    ceiling: Ceiling


class Outlier(NamedTuple):
    """A view that was left out."""

    view: BoardView
    typical_px: float  # miss of its corners, against the lens of the others


class HeldOut(NamedTuple):
    """Views against the lens of other ones."""

    rms_px: float
    rms_mm: float  # as on the floor below the camera
    lenses_mm: float  # by which the lenses of the parts differ from the whole's over the arena, rms


@dataclass(frozen=True)
class Measured:
    """A lens and all that is known of it."""

    conditions: Conditions
    fit: Fit
    outliers: tuple[Outlier, ...]

    @cached_property
    def floor(self) -> FloorErrors:
        return FloorErrors(self.fit.lens, self.conditions.ceiling)

    @cached_property
    def coverage(self) -> Coverage:
        return Coverage.of(self.fit, self.conditions.ceiling)

    @property
    def arena_mm(self) -> float:
        """Uncertainty over the arena, rms: by noise or by leaving out views, whichever is larger [mm]."""
        return max(self.floor.rms_mm(self.fit.covariance), self.floor.rms_mm(self.fit.jackknife))

    @property
    def shared_errors(self) -> float:
        """How many times larger the uncertainty is by leaving out views than by noise."""
        noise_mm = self.floor.rms_mm(self.fit.covariance)
        return self.floor.rms_mm(self.fit.jackknife) / noise_mm if np.isfinite(noise_mm) else 1.0

    @property
    def focal_sigma(self) -> float:
        """Standard deviation of the focal length, relative; the worse of two."""
        return float((np.sqrt(np.diag(self.fit.covariance)) / self.fit.lens.values)[:2].max())

    @cached_property
    def wanted(self) -> Wanted:
        return next_view(self.fit, self.floor, self.coverage, self.conditions.board)

    def faults(self) -> list[str]:
        """Return why the lens cannot be used; none: it can."""
        views, outliers = len(self.fit.views), len(self.outliers)
        faults = []
        if views < VIEWS:
            faults.append(
                f"{views} views can be used: {VIEWS} or more are needed, from places and directions that differ"
            )
        if outliers > OUTLIERS * (views + outliers):
            faults.append(
                f"{outliers} of {views + outliers} views do not fit the others: "
                "did focus or zoom change, or the board bend?"
            )
        if not self.fit.noise_px <= NOISE_PX:
            hint = "" if self.conditions.kind == "fisheye" else ", or the lens one for --lens fisheye"
            faults.append(
                f"corners lie {self.fit.noise_px:.2f} px from where they should: is the board another one{hint}?"
            )
        faults += self.coverage.faults()
        if self.floor.folds:
            faults.append(
                "the fitted lens is impossible near the image's corners: show the board there, or try --lens fisheye"
            )
        elif not self.arena_mm <= ARENA_MM:
            faults.append(
                f"places are uncertain by {self.arena_mm:.2f} mm rms over the arena: at most {ARENA_MM:g} mm is needed"
            )
        if not self.focal_sigma <= FOCAL:
            faults.append(f"the focal length is uncertain by {self.focal_sigma:.2%}: at most {FOCAL:.1%} is needed")
        if faults:
            faults.append(f"next view: {self.wanted}")
        return faults

    def warnings(self) -> list[str]:
        """Return what is worth knowing of a lens that can be used."""
        names = [f"{view.name} ({miss:.2f} px)" for view, miss in self.outliers]
        warnings = [f"left out, as they do not fit: {', '.join(names)}"] if names else []
        if self.shared_errors > _SHARED:
            most = sorted(zip(self.fit.surprise, self.fit.views, strict=True), key=lambda pair: -pair[0])[:_NAMED_VIEWS]
            warnings.append(
                f"views contradict one another {self.shared_errors:.1f} times more than their corners' noise explains, "
                f"{', '.join(view.name for _, view in most)} most: "
                f"a board that is not flat, a shutter that rolls{self._richer()}"
            )
        return warnings

    def _richer(self) -> str:
        """Return in words which model of the lens is the next to try."""
        more = [count for count in COEFFICIENTS[self.conditions.kind] if count > self.conditions.coefficients]
        return f", or a lens that needs more: try --coefficients {more[0]}" if more else ", or another kind of lens"

    def held_out(self) -> HeldOut:
        """Return how the lens of four fifths of the views does on the rest, in turn."""
        squares, changes, count = 0.0, [], 0
        folds = min(_FOLDS, len(self.fit.views))
        for k in range(folds):
            others = self.fit.without(range(k, len(self.fit.views), folds))
            changes.append(self.floor.shift_mm(others.lens.values - self.fit.lens.values))
            for view in self.fit.views[k::folds]:
                residuals = _against(others, view)
                squares, count = squares + float((residuals * residuals).sum()), count + len(residuals)
        rms_px = float(np.sqrt(squares / count))
        mm_a_pixel = 1e3 * self.conditions.ceiling.height_m / float(self.fit.lens.values[:2].mean())
        return HeldOut(rms_px, rms_px * mm_a_pixel, float(np.sqrt(np.mean(np.square(changes)))))

    def figures(self, held_out: HeldOut) -> dict[str, float | None]:
        """Return what a reader of the calibration needs, by name with unit."""
        fit, floor = self.fit, self.floor
        return {
            "views": len(fit.views),
            "views_left_out": len(self.outliers),
            "corners": sum(len(view.ids) for view in fit.views),
            "corner_noise_px": fit.noise_px,
            "reprojection_rms_px": float(np.sqrt(np.mean(np.square(np.concatenate(fit.residuals)).sum(axis=1)))),
            "held_out_rms_px": held_out.rms_px,
            "held_out_rms_mm": held_out.rms_mm,
            "held_out_lenses_mm": held_out.lenses_mm,
            "arena_rms_mm": floor.rms_mm(fit.covariance),
            "arena_max_mm": floor.max_mm(fit.covariance),
            "arena_leaving_out_rms_mm": floor.rms_mm(fit.jackknife),
            "arena_pose_fixed_rms_mm": floor.rms_mm(fit.covariance, refitted=False),
            "camera_height_m": self.conditions.ceiling.height_m,
            "tag_height_m": self.conditions.ceiling.tag_height_m,
            "focal_sigma_percent": 100 * self.focal_sigma,
        }

    def model(self, camera: str, held_out: HeldOut) -> CameraModel:
        """Return the calibration, without a place of the camera."""
        lens = self.fit.lens
        f_x, f_y, c_x, c_y, *distortion = (round(float(value), 9) for value in lens.values)
        return CameraModel(
            camera=camera,
            lens=lens.kind,
            width=lens.size[0],
            height=lens.size[1],
            focal_px=(f_x, f_y),
            centre_px=(c_x, c_y),
            distortion=tuple(distortion),
            intrinsics=provenance(
                "intrinsics",
                {view.name: view.image.tobytes() for view in self.fit.views},
                self.figures(held_out),
                lens.names,
                self.fit.covariance.tolist(),
            ),
        )


def measure(views: Sequence[BoardView], conditions: Conditions) -> Measured:
    """Fit a lens to views; those that do not fit the others are left out, worst first.

    Raises:
        CalibrationError: when no lens comes near to them.
    """
    left_out: list[BoardView] = []
    try:
        with np.errstate(all="ignore"):  # steps that lead nowhere overflow, and are taken back
            whole = fit(conditions.kind, conditions.coefficients, conditions.size, views)
            while len(whole.views) > VIEWS / 2:
                surprise = whole.surprise
                if surprise.max() <= max(_PULL, _PULL_RATIO * float(np.median(surprise))):
                    break
                worst = int(surprise.argmax())
                left_out.append(whole.views[worst])
                whole = whole.without([worst])
    except (ArithmeticError, ValueError, cv2.error) as error:  # numpy's LinAlgError is a ValueError
        raise CalibrationError(_HOPELESS) from error
    if not whole.noise_px < _HOPELESS_PX:
        raise CalibrationError(_HOPELESS)
    return Measured(conditions, whole, tuple(Outlier(view, typical(_against(whole, view))) for view in left_out))


def _against(whole: Fit, view: BoardView) -> Array:
    """Return the residuals (M, 2) of a view against a lens that does not know it, at the pose that suits best [px]."""
    return whole.lens.project(view.points, whole.lens.pose(view))[0] - view.pixels
