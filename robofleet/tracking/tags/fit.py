"""Fits tags to an image by least squares: the kernels of ``photometric.py``.

Each pass solves for a step of the pose, of the brightness and its slopes, of the contrast and of the blur. It leaves
out pixels whose grey was too far from the pass before: they show something else, as a cable or another robot. The first
pass takes some of the pixels only, and the others all of them.

The inverse of the normal equations, times the variance of what is left, is the covariance of the pose.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.kernels import image_kernel
from robofleet.tracking.tags import shape
from robofleet.tracking.tags.imaging import (
    KNOWN,
    NARROWEST,
    WIDEST,
    blur_at,
    corner_share,
    learn_blur,
    learn_quiet,
    quiet_variance,
)
from robofleet.tracking.tags.mapping import map_pixels, on_level, shift_map, sight_slope
from robofleet.tracking.tags.pixels import BLOCKED, CHUNK, MOST_ROWS, PARAMETERS, SHAPED, SLOTS, accumulate, likeness
from robofleet.tracking.tags.shape import TILT, turn_variance

_PASSES = 10  # at most
_COARSE = 12  # pixels along a side in the first pass, about; MOST_ROWS in the others
_WIDER = 1.4  # blur of the first pass over the expected one: it catches guesses that are further off
_CONVERGED_PX = 0.1  # a last step so short is the last: what it leaves is hundredths of it
_NEAR = 0.015  # step after which the last map of pixels is good still [sides]
_LONGEST_PX = 2.0  # step
_FURTHEST = 0.2  # from the guess [sides, rad]
_CUT, _KNOWN_CUT = 2.0, 4.0  # standard deviations of the noise beyond which a pixel shows something else
_TRUNCATED = 0.88  # standard deviation of a normal distribution that is cut off at _CUT
_MISFIT, _KNOWN_MISFIT = 0.2, 0.1  # of the contrast that a pixel may miss by itself, before and after the blur is known
_COVERED = 0.3  # share of a cell's pixels that show something else: then none of them counts
_PARTLY = 0.98  # share of a tag's pixels that count: with fewer, something covers it
_EVERYTHING = 1e9  # no cut [grey levels]
_LEAST_NOISE = 0.5  # [grey levels]
_BLUR_STEP_PX = 0.6  # at most, from pass to pass
_BLUR_CONVERGED_PX, _BLUR_KNOWN_PX = 0.05, 0.3  # what a blur may be off, before and after the camera's is known
_LEARNT_FROM = 0.9  # least likeness, and share of pixels that were not cut off
_GAIN = 0.2  # of what is learnt about a tag's noise
# What a fit knows of a tag's look, by index: brightness, its slopes forward and left, contrast [grey levels],
# blur [px], 1 where shadows or covers change it by parts.
CONTRAST, BLUR, STRUCTURED, LOOK = 3, 4, 5, 6
# That is so if fewer pixels count, or the variance is so much more than in even light; of tags that are as alike.
_COUNTED, _NOISY, _NOISY_COVERED, _STRUCTURED_FROM = 0.993, 1.6, 2.0, 0.6


class _Room(NamedTuple):
    """What the fit of one tag overwrites."""

    rows: Array  # (2, CHUNK), see pixels.py
    pixels: NDArray[np.float32]  # (SLOTS * CHUNK,)
    products: Array  # (9, 9)
    sums: Array  # (6,)
    none: Array  # (0, 15)
    no_blocks: Array  # (0, 10, 10)
    factor: Array  # (8, 8), lower triangle: Cholesky's, of the normal equations
    solution: Array  # (8,)
    level: Array  # (4,): brightness, its slopes forward and left, contrast [grey levels]
    nodes: Array  # (6, 9), see tag_map.py
    bend: Array  # (2, 6)
    shape: Array  # (2, 6)
    window: Array  # (6,)


@image_kernel
def fit_tags(  # type: ignore[no-untyped-def]
    image, camera, line_time, sides, heights, prints, cells, hidden, to_quadratic, index, centre, psi, velocity, omega,
    own_blur, camera_blur, blur_known, tone, doubt, quiet, noises, shapes, spreads, looks, covers, fit_centre,
    fit_psi, fit_alike, fit_row, fit_covariance,
):  # fmt: skip
    """Fill a ``Fit`` of M tags; return how many are structured. A tag that is not whole in the image is not alike at
    all.

    hidden (C * C,) cells do not count; none where it is empty. own_blur: of these tags [px]; 0: the camera's.
    camera_blur, blur_known, tone, doubt, quiet: the fields of ``Imaging``. noises (N,): of the targets [grey levels; 0:
    not known]. Blur and noises are learnt. shapes (N, 8), spreads (N, 8, 8): as ``shape.Shapes`` has them. looks (M,
    LOOK), covers (M, C * C): what is seen of each tag, and which of its cells are covered or hidden; filled.
    """
    n = PARAMETERS
    room = _Room(
        np.empty((2, CHUNK)), np.empty(SLOTS * CHUNK, np.float32), np.empty((n + 1, n + 1)), np.empty(6),
        np.empty((0, n + 1 + SHAPED)), np.empty((0, BLOCKED, BLOCKED)), np.empty((n, n)), np.empty(n), np.empty(4),
        np.empty((6, 9)), np.empty((2, 6)), np.empty((2, 6)), np.empty(6),
    )  # fmt: skip
    structured = 0
    for m in range(len(index)):
        i = index[m]
        fit_centre[m], fit_psi[m], fit_alike[m], fit_row[m] = _fit(
            image, camera, line_time, sides[i], heights[i], prints[i], cells, hidden, to_quadratic, centre[m], psi[m],
            velocity[m], omega[m], own_blur, camera_blur, blur_known, tone[0], doubt, quiet, noises, shapes[i],
            spreads[i], i, room, looks[m], covers[m], fit_covariance[m],
        )  # fmt: skip
        structured += looks[m, STRUCTURED] > 0.0
    return structured


@image_kernel
def _fit(  # type: ignore[no-untyped-def]  # noqa: PLR0912, PLR0915 - one loop of passes
    image, camera, line_time, side, height, corners, cells, hidden, to_quadratic, guess, guess_psi, velocity, omega,
    own_blur, camera_blur, blur_known, tone, doubt, quiet, noises, tag_shape, spread, i, room, look, cover, covariance,
):  # fmt: skip
    """Return centre, heading, likeness and row of one tag."""
    centre, psi, blur, noise, row = guess, guess_psi, own_blur, noises[i], 0.0
    share, near = 0.0, _BLUR_KNOWN_PX if own_blur > 0.0 or blur_known[0, 0] > KNOWN else _BLUR_CONVERGED_PX
    level, solution = room.level, room.solution
    level[:], covariance[:], look[:], cover[:] = 0.0, 0.0, 0.0, False
    known, cut = noise > 0.0, _EVERYTHING
    misfit = _KNOWN_MISFIT if known else _MISFIT
    variance = alike = left = before = side_px = wider = 0.0
    tally, by_cells = np.zeros((0, 2), np.int64), False  # by cells: pixels, and those that count
    mapped, slope = False, (0.0, 0.0)
    for step in range(_PASSES):
        if not mapped:
            row, side_px = map_pixels(
                camera, line_time, side, height, tag_shape, to_quadratic, centre, psi, velocity, omega, room.nodes,
                room.bend, room.shape, room.window,
            )  # fmt: skip
            slope = sight_slope(camera, side, height, centre, room.shape, room.window)
            if step == 0 and own_blur == 0.0:
                share = corner_share(image, room.nodes[0, 4], room.nodes[1, 4])
                blur = blur_at(camera_blur, share)
        inside = _look(image, corners, cells, hidden, tally, side_px, blur, tone, cut, step == 0, room)
        left, seen = room.products[0, 0], room.sums[0]
        if inside and step == 1 and known and left < _LEARNT_FROM * seen:
            known, misfit, cut = False, _MISFIT, _EVERYTHING  # a bad guess, or partly covered: see what it is
            continue
        if not inside or left < 3 * PARAMETERS:
            return guess, guess_psi, 0.0, row
        squares = _solve(room.products, room.factor, solution)
        level += solution[:4]
        forward, aside, spin, length = _step(side_px, level[3], solution)
        centre += side * complex(math.cos(psi), math.sin(psi)) * on_level(forward, aside, tag_shape[TILT:], slope)
        psi += spin
        if not (length >= 0.0 and abs(centre - guess) < _FURTHEST * side and abs(psi - guess_psi) < _FURTHEST):
            return guess, guess_psi, 0.0, row
        mapped = line_time == 0.0 and length < _NEAR * side_px and (step == 0 or not mapped)
        shift_map(room.shape, forward, aside, spin)
        if step == 0:
            cut = max(_KNOWN_CUT * noise, misfit * level[3]) if known else _EVERYTHING
            continue
        variance = squares / (left - PARAMETERS)
        wider = solution[7] / level[3]
        if abs(wider) > near:
            blur, near = _wider(blur, wider, length), _BLUR_CONVERGED_PX
        if not by_cells:  # a tag is known by all of it that may be seen
            alike = likeness(room.sums)
        steady, before = left > _PARTLY * seen or abs(left - before) < 0.01 * left, left
        done = length < _CONVERGED_PX and steady and abs(wider) <= near
        if not known:  # cut more and more off, until that is no more than of a normal distribution
            noise = math.sqrt(variance) / (_TRUNCATED if cut < _EVERYTHING else 1.0)
            known = _CUT * noise > 0.9 * cut or cut < 1.1 * misfit * level[3]
            cut = max((_KNOWN_CUT if known else _CUT) * noise, misfit * level[3])
        elif len(tally):
            _find_covered(tally, hidden, cells, cover)
            hidden, tally = cover, np.zeros((0, 2), np.int64)
            if noises[i] > 0.0:
                cut = max(_KNOWN_CUT * noise, _KNOWN_MISFIT * level[3])
        elif done and (by_cells or left > _PARTLY * seen):
            break
        elif done:
            tally, by_cells = np.zeros((cells * cells, 2), np.int64), True
    if min(alike, left / room.sums[0]) > _LEARNT_FROM and not by_cells and own_blur == 0.0:
        noise = max(math.sqrt(variance), _LEAST_NOISE)
        noises[i] = noise if noises[i] == 0.0 else noises[i] + _GAIN * (noise - noises[i])
        learn_quiet(quiet, level[0], noise * noise)
        wider += blur - blur_at(camera_blur, share)
        learn_blur(camera_blur, blur_known, share, wider, variance / (room.factor[7, 7] * level[3]) ** 2)
    for k in range(CONTRAST + 1):
        look[k] = level[k]
    look[BLUR] = blur
    if alike > _STRUCTURED_FROM:
        covered = len(hidden) > 0  # without the covered cells the others may look as they should
        noisy = variance > (_NOISY_COVERED if covered else _NOISY) * quiet_variance(quiet, level[0])
        look[STRUCTURED] = 1.0 if noisy or (not covered and left < _COUNTED * room.sums[0]) else 0.0
    _covary(room.factor, variance / (level[3] * level[3]), doubt, side, psi, covariance)
    covariance[5] += turn_variance(slope, spread)
    return centre, psi, alike, row


@image_kernel
def _look(image, corners, cells, hidden, tally, side_px, blur, tone, cut, coarse, room):  # type: ignore[no-untyped-def]
    """Fill the equations of one pass; return whether the tag is whole in the image."""
    stride = max(1, round(side_px / _COARSE)) if coarse else 1 + int(side_px / MOST_ROWS)
    return side_px > 0.0 and accumulate(
        image, room.shape, room.window, corners, cells, hidden, tally, side_px, _WIDER * blur if coarse else blur,
        tone, room.level, cut, stride, room.rows, room.pixels, room.products, room.sums, (0.0, 0.0), room.none,
        room.no_blocks,
    )  # fmt: skip


@image_kernel
def _wider(blur, by, length):  # type: ignore[no-untyped-def]
    """Return the blur for the next pass [px]; a pass with a long step says nothing of it."""
    return min(max(blur + min(max(by, -_BLUR_STEP_PX), _BLUR_STEP_PX), NARROWEST), WIDEST) if length < 0.5 else blur


@image_kernel
def _step(side_px, contrast, solution):  # type: ignore[no-untyped-def]
    """Return a step forward, left [sides] and counter-clockwise [rad], and how far it goes [px]; -1: there is no
    contrast, or it is that of a negative."""
    if not contrast > 1.0:
        return 0.0, 0.0, 0.0, -1.0
    forward, left, spin = -solution[4] / contrast, -solution[5] / contrast, -solution[6] / contrast
    length = side_px * math.hypot(forward, left)
    shorter = min(1.0, _LONGEST_PX / max(length, 1e-9))
    return shorter * forward, shorter * left, shorter * spin, max(length, 0.5 * side_px * abs(spin))


@image_kernel
def _find_covered(tally, hidden, cells, cover):  # type: ignore[no-untyped-def]
    """Mark the cells (C * C,) that are hidden, or show something else."""
    for cell in range(cells * cells):
        cover[cell] = tally[cell, 1] < (1.0 - _COVERED) * tally[cell, 0] or (len(hidden) > 0 and hidden[cell])


@image_kernel
def _solve(products, factor, solution):  # type: ignore[no-untyped-def]
    """Solve the normal equations by Cholesky's decomposition. Return the sum of squares that is left."""
    squares = products[PARAMETERS, PARAMETERS]
    for i in range(PARAMETERS):
        for j in range(i + 1):
            total = products[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(total, 1e-7 * products[i, i] + 1e-9))
            else:
                factor[i, j] = total / factor[j, j]
        total = products[PARAMETERS, i]
        for k in range(i):
            total -= factor[i, k] * solution[k]
        solution[i] = total / factor[i, i]
        squares -= solution[i] * solution[i]
    for i in range(PARAMETERS - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, PARAMETERS):
            total -= factor[k, i] * solution[k]
        solution[i] = total / factor[i, i]
    return max(squares, 1e-6)


@image_kernel
def _covary(factor, noise, doubt, side, psi, covariance):  # type: ignore[no-untyped-def]
    """Write the covariance (6,) of x, y [m; world] and psi [rad]: xx, xy, yy, x psi, y psi, psi psi; noise and model
    are variances of a pixel's grey [contrasts^2]."""
    # The last rows of the equations' inverse need the last rows of their factor only.
    inverse = np.zeros((4, 4))
    for i in range(4):
        inverse[i, i] = 1.0 / factor[4 + i, 4 + i]
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total -= factor[4 + i, 4 + k] * inverse[k, j]
            inverse[i, j] = total / factor[4 + i, 4 + i]
    products = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(max(i, j), 4):
                products[i, j] += inverse[k, i] * inverse[k, j]
    c, s, area = math.cos(psi), math.sin(psi), side * side * noise * doubt[0]
    ff, fl, ll = products[0, 0], products[0, 1], products[1, 1]
    covariance[0] = area * (c * c * ff - 2.0 * c * s * fl + s * s * ll)
    covariance[1] = area * (c * s * (ff - ll) + (c * c - s * s) * fl)
    covariance[2] = area * (s * s * ff + 2.0 * c * s * fl + c * c * ll)
    both = side * noise * math.sqrt(doubt[0] * doubt[1])
    covariance[3] = both * (c * products[0, 2] - s * products[1, 2])
    covariance[4] = both * (s * products[0, 2] + c * products[1, 2])
    covariance[5] = noise * doubt[1] * products[2, 2]


@image_kernel
def add_up_tag(  # type: ignore[no-untyped-def]
    image, camera, line_time, side, height, corners, cells, hidden, to_quadratic, centre, psi, velocity, omega,
    tag_shape, blur, tone, level, cut, products, blocks, slope,
):  # fmt: skip
    """Add up all pixels of a tag where it was fitted. Return the share of those that count.

    products (15, 15): of the coefficients of light, pose and blur, of what is left of the grey, and of the shape's
    coefficients. blocks (B, 10, 10): of the first nine and the response's coefficient, by blocks. slope (2,): under
    which the tag is seen.
    """
    n = PARAMETERS + 1
    nodes, bend, shape, window = np.empty((6, 9)), np.empty((2, 6)), np.empty((2, 6)), np.empty(6)
    sums, shaped, first = np.empty(6), np.empty((SHAPED, n + SHAPED)), np.empty((n, n))
    _, side_px = map_pixels(
        camera, line_time, side, height, tag_shape, to_quadratic, centre, psi, velocity, omega, nodes, bend, shape,
        window,
    )  # fmt: skip
    slope[0], slope[1] = sight_slope(camera, side, height, centre, shape, window)
    inside = side_px > 0.0 and accumulate(
        image, shape, window, corners, cells, hidden, np.zeros((0, 2), np.int64), side_px, blur, tone, level, cut,
        1 + int(side_px / MOST_ROWS), np.empty((2, CHUNK)), np.empty(SLOTS * CHUNK, np.float32), first, sums,
        (slope[0], slope[1]), shaped, blocks,
    )  # fmt: skip
    if not inside:
        return 0.0
    for i in range(n):
        for j in range(i + 1):
            products[i, j] = products[j, i] = first[i, j]
    for i in range(SHAPED):
        for j in range(n + i + 1):
            products[n + i, j] = products[j, n + i] = shaped[i, j]
    for b in range(len(blocks)):
        for i in range(BLOCKED):
            for j in range(i):
                blocks[b, j, i] = blocks[b, i, j]
    return first[0, 0] / sums[0]


KERNELS: tuple[Any, ...] = (
    fit_tags,
    add_up_tag,
    on_level,
    quiet_variance,
    *shape.KERNELS,
)  # that are called from Python
