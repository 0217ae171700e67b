"""Places tags to a few hundredths of a pixel by the greys of their whole pattern.

A tag's neighbourhood on its plane maps to pixels by a biquadratic, exact in nine nodes that go through the whole camera
model: lens, tilt, height, and under a rolling shutter the way that the tag covers from row to row. The pattern is
sampled through that map, and (contrast, brightness, slope of the light, offset, turn) are fitted by Gauss-Newton
steps, each one product with a pseudo-inverse made beforehand from the template's derivatives. The correlation with
the template says whether it is this tag: another id of the family reaches 0.65.

Points of the plane are complex numbers, x + iy; in the tag's own frame, forward + i left [sides].
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import image_kernel
from robofleet.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.projection import project
from robofleet.tracking.targets import Target

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_SAMPLES_PX = 1.0  # of the fitted square, a pixel; fewer alias, and the error then depends on where the edges lie
_FEWEST, _MOST = 16, 64  # samples along a side
_REACH = 0.56  # half the fitted square [sides]: half of the white cell beyond the black rim
_BLUR_PX = 0.65  # standard deviation expected of lens, pixel and interpolation; a wrong one does not bias
_STEPS = 5  # Gauss-Newton, at most
_CONVERGED = 0.001  # a last step this short is the last [sides, rad]
_LONGEST_STEP = 0.06  # [sides]
_FURTHEST = 0.2  # from the guess [sides]
_NONE = np.zeros(0, np.int64)
_KEPT = 200  # templates of partly covered tags at most: one takes 30 kB and a millisecond
_NODES = np.array([0.7 * (i + 1j * j) for j in (-1, 0, 1) for i in (-1, 0, 1)])  # [sides]


class Fit(NamedTuple):
    """M tags as an image shows them."""

    centre: Complex  # (M,) [m; world]
    psi: Array  # (M,) [rad; CCW +]
    alike: Array  # (M,) correlation with the pattern; 0 where the fit left the neighbourhood of the guess
    row: Array  # (M,) of the image in which the centre lies [px]

    def of(self, which: Indices) -> "Fit":
        """Return some of them."""
        return Fit(self.centre[which], self.psi[which], self.alike[which], self.row[which])


class PhotometricFit:
    """Fits tags of known pattern, size and height near where they are expected."""

    def __init__(self, geometry: CameraGeometry, targets: Sequence[Target], line_time: float = 0.0) -> None:
        """Take a rolling shutter's time from row to row [s]."""
        self.geometry = geometry
        self._line_time = line_time
        self.family = targets[0].family
        self._sides = np.array([target.side for target in targets])
        self.heights = np.array([target.height for target in targets])
        sizes = [side_px(geometry, target) for target in targets]
        at = _samples(round(min(max(_SAMPLES_PX * 2.0 * _REACH * max(sizes), _FEWEST), _MOST)))
        self._prints = [(pattern(target.tag, self.family), px) for target, px in zip(targets, sizes, strict=True)]
        self._templates = np.stack([_template(white, px, at) for white, px in self._prints])
        self._partly: dict[tuple[int, bytes], tuple[NDArray[np.float32], Indices]] = {}  # templates, concealed samples
        self._at = at[0].real.astype(np.float32)
        self._to_coefficients = np.linalg.inv(_monomials(_NODES))
        self.fit(
            np.zeros((4, 4), np.uint8), np.arange(1), np.zeros(1, np.complex128), np.zeros(1)
        )  # compiles, or loads

    def fit(
        self,
        image: NDArray[np.uint8],
        index: Indices,
        centre: Complex,
        psi: Array,
        velocity: Complex | None = None,
        omega: Array | None = None,
    ) -> Fit:
        """Return the poses near the guesses ``centre``, ``psi`` (M,) of the targets ``index`` (M,).

        velocity (M,) [m/s; world] and omega (M,) [rad/s] are used under a rolling shutter alone.
        """
        return self._fitted(image, self._templates, _NONE, index, index, centre, psi, velocity, omega)

    def fit_partly(
        self,
        image: NDArray[np.uint8],
        target: int,
        covered: NDArray[np.bool_],
        centre: complex,
        psi: float,
        velocity: complex = 0.0,
        omega: float = 0.0,
    ) -> Fit:
        """Return the pose of one target by the cells that are not ``covered`` (C, C), row 0 at the print's top."""
        key = target, covered.tobytes()
        if key not in self._partly:
            at = self._at[None, :] - 1j * self._at[:, None]
            cell = np.clip(np.floor((self._at + 0.5) * len(covered)), 0, len(covered) - 1).astype(int)
            seen = ~covered[cell[:, None], cell]
            if len(self._partly) >= _KEPT:
                self._partly.clear()
            self._partly[key] = _template(*self._prints[target], at, seen)[None], np.flatnonzero(~seen)
        template, concealed = self._partly[key]
        one = np.array([target]), np.array([centre]), np.array([psi]), np.array([velocity + 0j]), np.array([omega])
        return self._fitted(image, template, concealed, np.zeros(1, np.int64), *one)

    def _fitted(
        self,
        image: NDArray[np.uint8],
        templates: NDArray[np.float32],
        concealed: Indices,
        which: Indices,
        index: Indices,
        centre: Complex,
        psi: Array,
        velocity: Complex | None,
        omega: Array | None,
    ) -> Fit:
        """Return the poses of the targets ``index`` by the templates ``which`` (M,)."""
        m = len(index)
        if velocity is None or omega is None:
            velocity, omega = np.zeros(m, np.complex128), np.zeros(m)
        fit = Fit(np.empty(m, np.complex128), np.empty(m), np.empty(m), np.empty(m))
        _fit(
            image, self.geometry.flat, self._line_time, self._sides, self.heights, self._to_coefficients, self._at,
            templates, concealed, which, index, centre, psi, velocity, omega, *fit,
        )  # fmt: skip
        return fit

    def pixels(self, index: Indices, centre: Complex) -> Array:
        """Return where points (M,) on the targets' planes appear (M, 2) [px]."""
        return self._project(centre[:, None], index)[:, 0]

    def _project(self, points: Complex, index: Indices) -> Array:
        """Return the pixels (M, K, 2) of points (M, K) on the planes of the targets ``index``."""
        world = np.empty((*points.shape, 3))
        world[..., 0], world[..., 1], world[..., 2] = points.real, points.imag, self.heights[index, None]
        return self.geometry.project(world).reshape(*points.shape, 2)


def side_px(geometry: CameraGeometry, target: Target) -> float:
    """Return a tag's side straight below the camera [px]."""
    return float(geometry.K[0, 0]) * target.side / (float(geometry.position[2]) - target.height)


def dictionary(family: str) -> cv2.aruco.Dictionary:
    """Return all tags of a family."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))


def pattern(tag: int, family: str) -> NDArray[np.bool_]:
    """Return the tag's cells (C, C), black rim included, true where white, row 0 at the top as OpenCV prints it."""
    return np.asarray(dictionary(family).generateImageMarker(tag, FAMILIES[family].cells) > 0)


def _samples(count: int) -> Complex:
    """Return where the fit samples a tag, (count, count), row 0 at the print's top."""
    at = ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * _REACH
    return at[None, :] - 1j * at[:, None]


def _monomials(points: Complex) -> Array:
    """Return a^i b^j, (n, 9), of points a + ib; i varies fastest."""
    a, b = points.real, points.imag
    return np.stack([a**i * b**j for j in range(3) for i in range(3)], axis=-1)


def _template(
    white: NDArray[np.bool_], side_px: float, at: Complex, seen: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """Return the rows (5, n) to multiply a patch of n greys with, sampled at ``at``; 0 where it is not ``seen``.

    Correlation times the patch's norm; contrast; contrast times the offset forward, left [sides] and counter-clockwise
    [rad]. Brightness and a slope of the light are fitted too, and dropped.
    """
    blur = _BLUR_PX / side_px
    z = (at[0].real[:, None] - (np.arange(len(white) + 1) / len(white) - 0.5)) / blur
    step = np.vectorize(math.erf)(z / math.sqrt(2.0)) / 2.0
    slope = np.exp(-z * z / 2.0) / (blur * math.sqrt(2.0 * math.pi))
    cell, edge, black = step[:, :-1] - step[:, 1:], slope[:, :-1] - slope[:, 1:], 1.0 - white
    look, forward, left = -cell @ black @ cell.T, -cell @ black @ edge.T, edge @ black @ cell.T
    spin = at.real * left - at.imag * forward
    basis = np.stack([look, -forward, -left, -spin, np.ones_like(look), at.real, at.imag]).reshape(7, -1)
    if seen is not None:
        rows = np.zeros((5, at.size))
        basis = basis[:, seen.ravel()]
        look = basis[0] - basis[0].mean()
        rows[0, seen.ravel()] = look / np.linalg.norm(look)
        rows[1:, seen.ravel()] = np.linalg.solve(basis @ basis.T, basis)[:4]  # at once, in the middle of a run
        return rows.astype(np.float32)
    look = look.ravel() - look.mean()
    rows = np.vstack([look / np.linalg.norm(look), np.linalg.pinv(basis.T)[:4]])
    return rows.astype(np.float32)


@image_kernel
def _fit(  # type: ignore[no-untyped-def]
    image, camera, line_time, sides, heights, to_coefficients, at, templates, concealed, which,
    index, centre, psi, velocity, omega, fit_centre, fit_psi, fit_alike, fit_row,
):  # fmt: skip
    """Fill a ``Fit``. A tag that is not whole in the image is not alike at all."""
    patch, pixels = np.empty(len(at) * len(at), np.float32), np.empty((len(_NODES), 2))
    for m in range(len(index)):
        side, height = sides[index[m]], heights[index[m]]
        turned = side * complex(math.cos(psi[m]), math.sin(psi[m]))
        _, fit_row[m] = project(camera, centre[m].real, centre[m].imag, height)
        for n in range(len(_NODES)):
            arm = turned * _NODES[n]
            point = centre[m] + arm
            u, v = project(camera, point.real, point.imag, height)
            if line_time > 0.0:
                point += (velocity[m] + 1j * omega[m] * arm) * ((v - fit_row[m]) * line_time)
                u, v = project(camera, point.real, point.imag, height)
            pixels[n, 0], pixels[n, 1] = u, v
        guessed = _product(to_coefficients, pixels)
        x, y, turn, alike = _settle(image, guessed, to_coefficients, at, templates[which[m]], concealed, patch)
        fit_centre[m], fit_psi[m], fit_alike[m] = centre[m] + turned * complex(x, y), psi[m] + turn, alike


@image_kernel
def _settle(image, guessed, to_coefficients, at, template, concealed, patch):  # type: ignore[no-untyped-def]
    """Return forward, left [sides] and turn [rad] from the guess, and the correlation.

    guessed (9, 2): the map from the tag's frame to pixels, around the guess.
    """
    x = y = turn = alike = 0.0
    for _ in range(_STEPS):
        local = _product(to_coefficients, _map(guessed, x, y, turn))
        if not _sample(image, local, at, patch):
            return x, y, turn, 0.0
        if len(concealed):
            _conceal(patch, concealed)
        alike, forward, left, spin = _compare(patch, template)
        length = math.hypot(forward, left)
        if length > _LONGEST_STEP:
            shorter = _LONGEST_STEP / length
            forward, left, spin = shorter * forward, shorter * left, shorter * spin
        c, s = math.cos(turn), math.sin(turn)
        x, y, turn = x + c * forward - s * left, y + s * forward + c * left, turn + spin
        if length < _CONVERGED and abs(spin) < _CONVERGED:
            break
    if math.hypot(x, y) > _FURTHEST or abs(turn) > _FURTHEST:
        alike = 0.0
    return x, y, turn, alike


@image_kernel
def _product(matrix, pixels):  # type: ignore[no-untyped-def]
    """Return a (9, 9) matrix times (9, 2) pixels: numba's own product needs scipy."""
    result = np.zeros((9, 2))
    for i in range(9):
        for k in range(9):
            for axis in range(2):
                result[i, axis] += matrix[i, k] * pixels[k, axis]
    return result


@image_kernel
def _map(coefficients, x, y, turn):  # type: ignore[no-untyped-def]
    """Return where the nodes (9, 2) of a tag appear that is off by x, y [sides] and turn [rad]."""
    c, s = math.cos(turn), math.sin(turn)
    pixels = np.empty((9, 2))
    for n in range(9):
        node = _NODES[n]
        a, b = x + c * node.real - s * node.imag, y + s * node.real + c * node.imag
        for axis in range(2):
            k = coefficients[:, axis]
            pixels[n, axis] = (
                (k[0] + a * (k[1] + a * k[2]))
                + b * ((k[3] + a * (k[4] + a * k[5])) + b * (k[6] + a * (k[7] + a * k[8])))
            )  # fmt: skip
    return pixels


@image_kernel
def _sample(image, coefficients, at, patch):  # type: ignore[no-untyped-def]
    """Fill ``patch`` with the greys at the grid ``at`` x ``at``, top row first; False if it leaves the image."""
    one, count = np.float32(1.0), len(at)
    width, height = image.shape[1], image.shape[0]
    for row in range(count):
        b = -at[row]
        k = np.empty((3, 2), np.float32)
        for i in range(3):
            for axis in range(2):
                k[i, axis] = coefficients[i, axis] + b * (coefficients[3 + i, axis] + b * coefficients[6 + i, axis])
        u0, u1, u2, v0, v1, v2 = k[0, 0], k[1, 0], k[2, 0], k[0, 1], k[1, 1], k[2, 1]
        for end in (0, count - 1):
            a = at[end]
            u, v = u0 + a * (u1 + a * u2), v0 + a * (v1 + a * v2)
            if not (u > 0.0 and v > 0.0 and u < width - 1.5 and v < height - 1.5):
                return False
        for column in range(count):
            a = at[column]
            u, v = u0 + a * (u1 + a * u2), v0 + a * (v1 + a * v2)
            left, top = np.int32(u), np.int32(v)
            u, v = u - np.float32(left), v - np.float32(top)
            upper = (one - u) * np.float32(image[top, left]) + u * np.float32(image[top, left + 1])
            lower = (one - u) * np.float32(image[top + 1, left]) + u * np.float32(image[top + 1, left + 1])
            patch[row * count + column] = upper + v * (lower - upper)
    return True


@image_kernel
def _conceal(patch, concealed):  # type: ignore[no-untyped-def]
    """Give the samples that are not to count the mean of the others, which adds nothing to the patch's variance."""
    total = np.float32(0.0)
    for n in range(len(patch)):
        total += patch[n]
    for n in concealed:
        total -= patch[n]
    mean = total / np.float32(len(patch) - len(concealed))
    for n in concealed:
        patch[n] = mean


@image_kernel
def _compare(patch, template):  # type: ignore[no-untyped-def]
    """Return the patch's correlation with a template, and the step towards it: forward, left [sides], turn [rad]."""
    total = squares = np.float32(0.0)
    look = contrast = forward = left = spin = np.float32(0.0)
    for n in range(len(patch)):
        gray = patch[n] - np.float32(128.0)
        total += gray
        squares += gray * gray
        look += gray * template[0, n]
        contrast += gray * template[1, n]
        forward += gray * template[2, n]
        left += gray * template[3, n]
        spin += gray * template[4, n]
    norm = max(squares - total * total / len(patch), np.float32(1.0)) ** 0.5
    contrast = max(contrast, np.float32(1.0))  # less is no tag
    return look / norm, forward / contrast, left / contrast, spin / contrast


KERNELS = (_fit,)  # that are called from Python
