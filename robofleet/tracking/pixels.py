"""Fits tags to the greys of single pixels: the kernels of ``photometric.py``.

Each pixel in a tag's square is compared, at its own centre, with what the print shows there: its pattern, as blurred as
the image. Nothing is interpolated, so the error does not depend on how the edges lie to the rows of pixels.

An edge is blurred by a quadratic B-spline, which is three equal boxes in a row: pixel, defocus and motion are boxes, or
nearly so. Its one number is the box's width; its variance is a quarter of the width squared.

The grey of a pixel is linear in eight numbers: brightness, its slopes forward and left, contrast, and contrast times
offset forward, offset left, turn, and wider blur. Each pass solves for them by least squares. It leaves out pixels
whose grey was too far from the pass before: they show something else, as a cable or another robot.

The inverse of the normal equations, times the variance of what is left, is the covariance of the pose.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import image_kernel
from robofleet.tracking.projection import project

REACH = 0.56  # half the fitted square [sides]: half of the white cell beyond the black rim
SLOTS, CHUNK = 17, 512  # numbers of a pixel; pixels that are computed at once
_P = 8  # parameters
_NODE = 0.6  # half the square whose map to pixels is computed [sides]
_PASSES = 10  # at most
_COARSE = 14  # pixels along a side in the first pass, about
_MOST = 150  # in the others
_WIDER = 1.4  # blur of the first pass over the expected one: it catches guesses that are further off
_CONVERGED_PX = 0.1  # a last step so short is the last: what it leaves is hundredths of it
_LONGEST_PX = 2.0  # step
_FURTHEST = 0.2  # from the guess [sides, rad]
_CUT, _KNOWN_CUT = 2.0, 4.0  # standard deviations of the noise beyond which a pixel shows something else
_TRUNCATED = 0.88  # standard deviation of a normal distribution that is cut off at _CUT
_MISFIT, _KNOWN_MISFIT = 0.2, 0.1  # of the contrast that a pixel may miss by itself, before and after the blur is known
_MODEL = 0.038  # error of the pattern as blurred here [contrasts], where the blur is a cell wide; by ray-cast images
_COVERED = 0.3  # share of a cell's pixels that show something else: then none of them counts
_PARTLY = 0.98  # share of a tag's pixels that count: with fewer, something covers it
_EVERYTHING = 1e9  # no cut [grey levels]
_LEAST_NOISE = 0.5  # [grey levels]
_NARROWEST, _WIDEST = 0.6, 3.0  # blur [px]
_LEARNT_FROM = 0.9  # least likeness, and share of pixels that were not cut off
_GAIN = 0.2  # of what is learnt about blur and noise


def vertices(white: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return what meets in the corners of a print's cells (C, C), ((C + 3)^2, 4), with a row of corners around them.

    Of the four cells around a corner, black -1 and white 0: the upper left one, what is more to the right, below, and
    in the diagonal beyond these two.
    """
    cells = np.pad(white.astype(np.float32) - 1.0, 2)
    a, b, c, d = cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]
    return np.ascontiguousarray(np.stack([a, b - a, c - a, d - c - b + a], axis=-1).reshape(-1, 4))


def quadratic() -> NDArray[np.float64]:
    """Return the matrix (6, 9) from values at the nodes of ``_map`` to coefficients of 1, a, b, a^2, ab, b^2."""
    b, a = (np.mgrid[-1:2, -1:2] * _NODE).reshape(2, -1)
    return np.asarray(np.linalg.pinv(np.stack([np.ones(9), a, b, a * a, a * b, b * b], axis=1)), np.float64)


@image_kernel
def fit_tags(  # type: ignore[no-untyped-def]
    image, camera, line_time, sides, heights, prints, cells, hidden, to_quadratic, index, centre, psi, velocity, omega,
    blurs, noises, room, fit_centre, fit_psi, fit_alike, fit_row, fit_covariance,
):  # fmt: skip
    """Fill a ``Fit`` of M tags. A tag that is not whole in the image is not alike at all.

    hidden (C * C,) cells do not count; none where it is empty. blurs [px] and noises [grey levels; 0: not known] (N,):
    what is known of the targets, and learnt. room (SLOTS, CHUNK) is overwritten.
    """
    shape, window = np.empty((2, 6)), np.empty(6)
    gram, solution = np.empty((_P, _P)), np.empty(_P)
    for m in range(len(index)):
        i = index[m]
        room[15] = np.float32(1.0)
        fit_centre[m], fit_psi[m], fit_alike[m], fit_row[m] = _fit(
            image, camera, line_time, sides[i], heights[i], prints[i], cells, hidden, to_quadratic, centre[m], psi[m],
            velocity[m], omega[m], blurs, noises, i, room, shape, window, gram, solution, fit_covariance[m],
        )  # fmt: skip


@image_kernel
def _fit(  # type: ignore[no-untyped-def]
    image, camera, line_time, side, height, corners, cells, hidden, to_quadratic, guess, guess_psi, velocity, omega,
    blurs, noises, i, room, shape, window, gram, solution, covariance,
):  # fmt: skip
    """Return centre, heading, likeness and row of one tag."""
    centre, psi, blur, noise, row = guess, guess_psi, blurs[i], noises[i], 0.0
    level, sums = np.zeros(4), np.empty(7)  # brightness, its slopes, contrast; see _accumulate
    known, cut = noise > 0.0, _EVERYTHING
    misfit = _KNOWN_MISFIT if known else _MISFIT
    variance = alike = left = before = side_px = 0.0
    tally, asked = np.zeros((0, 2), np.int64), False  # by cells: pixels, and those that count
    covariance[:] = 0.0
    for step in range(_PASSES):
        row, side_px = _map(camera, line_time, side, height, to_quadratic, centre, psi, velocity, omega, shape, window)
        coarse = step == 0
        stride = max(1, round(side_px / _COARSE)) if coarse else 1 + int(side_px / _MOST)
        width = _WIDER * blur if coarse else blur
        inside = side_px > 0.0 and _accumulate(
            image, shape, window, corners, cells, hidden, tally, side_px, width, level, cut, stride, room, gram,
            solution, sums,
        )  # fmt: skip
        if not (inside and gram[0, 0] >= 3 * _P):
            return guess, guess_psi, 0.0, row
        left, squares = gram[0, 0], _solve(gram, solution, sums[0])
        level += solution[:4]
        centre, psi, length = _step(centre, psi, side, side_px, level[3], solution)
        if not (length >= 0.0 and abs(centre - guess) < _FURTHEST * side and abs(psi - guess_psi) < _FURTHEST):
            return guess, guess_psi, 0.0, row
        if coarse:
            cut = max(_KNOWN_CUT * noise, misfit * level[3]) if known else _EVERYTHING
            continue
        variance = squares / (left - _P)
        if not asked:  # a tag is known by all of it that may be seen
            alike = _likeness(sums)
        steady = left > _PARTLY * sums[1] or abs(left - before) < 0.01 * left
        done = length < _CONVERGED_PX and steady
        before = left
        if step == 1 and known and left < _LEARNT_FROM * sums[1]:
            known, misfit, cut = False, _MISFIT, _EVERYTHING  # a bad guess, or partly covered: see what it is
        elif not known:  # cut more and more off, until that is no more than of a normal distribution
            noise = math.sqrt(variance) / (_TRUNCATED if cut < _EVERYTHING else 1.0)
            known = _CUT * noise > 0.9 * cut or cut < 1.1 * misfit * level[3]
            cut = max((_KNOWN_CUT if known else _CUT) * noise, misfit * level[3])
        elif len(tally):
            hidden, tally = _covered(tally, hidden, cells), np.zeros((0, 2), np.int64)
            if noises[i] > 0.0:
                cut = max(_KNOWN_CUT * noise, _KNOWN_MISFIT * level[3])
        elif done and (asked or left > _PARTLY * sums[1]):
            break
        elif done:
            tally, asked = np.zeros((cells * cells, 2), np.int64), True
    if alike > _LEARNT_FROM and not asked and left > _LEARNT_FROM * sums[1]:
        _learn(blurs, noises, i, solution[7] / level[3], math.sqrt(variance))
    variance += (_MODEL * level[3] * blur * cells / side_px) ** 2
    _covary(gram, variance / (level[3] * level[3]), side, psi, covariance)
    return centre, psi, alike, row


@image_kernel
def _step(centre, psi, side, side_px, contrast, solution):  # type: ignore[no-untyped-def]
    """Return centre and heading after a step, and how far that goes [px]; -1: there is no contrast, or it is that of a
    negative."""
    if not contrast > 1.0:
        return centre, psi, -1.0
    forward, left, spin = -solution[4] / contrast, -solution[5] / contrast, -solution[6] / contrast
    length = side_px * math.hypot(forward, left)
    shorter = min(1.0, _LONGEST_PX / max(length, 1e-9))
    centre += side * complex(math.cos(psi), math.sin(psi)) * shorter * complex(forward, left)
    return centre, psi + shorter * spin, max(length, 0.5 * side_px * abs(spin))


@image_kernel
def _learn(blurs, noises, i, wider, noise):  # type: ignore[no-untyped-def]
    """Follow a target's blur [px] and noise [grey levels]."""
    noise = max(noise, _LEAST_NOISE)
    noises[i] = noise if noises[i] == 0.0 else noises[i] + _GAIN * (noise - noises[i])
    blurs[i] = min(max(blurs[i] + _GAIN * min(max(wider, -0.5), 0.5), _NARROWEST), _WIDEST)


@image_kernel
def _map(camera, line_time, side, height, to_quadratic, centre, psi, velocity, omega, shape, window):  # type: ignore[no-untyped-def]
    """Fill ``shape`` (2, 6): forward and left [sides] as quadratics of a pixel from the window's origin; ``window``
    (6,): origin, first and last column, first and last row. Return the centre's row, and the side [px]; 0: no map."""
    turned = side * complex(math.cos(psi), math.sin(psi))
    u, v = np.empty(9), np.empty(9)
    _, row = project(camera, centre.real, centre.imag, height)
    for n in range(9):
        arm = turned * complex((n % 3 - 1) * _NODE, (n // 3 - 1) * _NODE)
        point = centre + arm
        u[n], v[n] = project(camera, point.real, point.imag, height)
        if line_time > 0.0:
            point += (velocity + 1j * omega * arm) * ((v[n] - row) * line_time)
            u[n], v[n] = project(camera, point.real, point.imag, height)
    scale = 0.5 / _NODE
    ua, va, ub, vb = (u[5] - u[3]) * scale, (v[5] - v[3]) * scale, (u[7] - u[1]) * scale, (v[7] - v[1]) * scale
    area = ua * vb - ub * va
    if not (16.0 < abs(area) < 1e8 and abs(u[4]) < 1e6 and abs(v[4]) < 1e6):
        return row, 0.0
    window[0], window[1] = round(u[4]), round(v[4])
    window[2], window[3] = math.ceil(u.min() - window[0]), math.floor(u.max() - window[0])
    window[4], window[5] = math.ceil(v.min() - window[1]), math.floor(v.max() - window[1])
    # The linear map from pixels; what it misses at the nodes, as a quadratic of what it gives; and once more.
    linear = np.array([[vb / area, -ub / area], [-va / area, ua / area]])
    z, missed, bend = np.empty((2, 9)), np.empty((2, 9)), np.zeros((2, 6))
    for axis in range(2):
        for n in range(9):
            z[axis, n] = linear[axis, 0] * (u[n] - u[4]) + linear[axis, 1] * (v[n] - v[4])
            missed[axis, n] = (n % 3 - 1 if axis == 0 else n // 3 - 1) * _NODE - z[axis, n]
    for _ in range(2):
        for axis in range(2):
            k = bend[axis]
            for c in range(6):
                for n in range(9):
                    k[c] += to_quadratic[c, n] * missed[axis, n]
            for n in range(9):
                a, b = z[0, n], z[1, n]
                missed[axis, n] = (n % 3 - 1 if axis == 0 else n // 3 - 1) * _NODE - z[axis, n]
                missed[axis, n] -= k[0] + a * (k[1] + a * k[3] + b * k[4]) + b * (k[2] + b * k[5])
    x, y = u[4] - window[0], v[4] - window[1]
    m, n, o, p = linear[0, 0], linear[0, 1], linear[1, 0], linear[1, 1]
    for axis in range(2):
        k, s = bend[axis], shape[axis]
        by_a, by_b = k[1] + 1.0 - axis, k[2] + axis
        s[1], s[2] = by_a * m + by_b * o, by_a * n + by_b * p
        s[3] = k[3] * m * m + k[4] * m * o + k[5] * o * o
        s[4] = 2.0 * k[3] * m * n + k[4] * (m * p + n * o) + 2.0 * k[5] * o * p
        s[5] = k[3] * n * n + k[4] * n * p + k[5] * p * p
        s[0] = k[0] - s[1] * x - s[2] * y + s[3] * x * x + s[4] * x * y + s[5] * y * y
        s[1], s[2] = s[1] - 2.0 * s[3] * x - s[4] * y, s[2] - 2.0 * s[5] * y - s[4] * x
    return row, math.sqrt(abs(area))


@image_kernel
def _accumulate(  # type: ignore[no-untyped-def]
    image, shape, window, corners, cells, hidden, tally, side_px, blur, level, cut, stride, room, gram, right, sums
):  # fmt: skip
    """Add up the normal equations, ``gram`` and ``right``, and ``sums``: squares of what is left; and of all pixels
    their number, the pattern, the grey, and the squares of these two ... Return whether the square is in the image."""
    products, sums[:] = np.zeros((_P + 1, _P + 1)), 0.0
    height, width = image.shape
    flat = room.reshape(-1)
    full = 0
    for y in range(int(window[4]), int(window[5]) + 1, stride):
        low, high = window[2], window[3]
        for axis in range(2):
            at, slope = shape[axis, 0] + y * (shape[axis, 2] + y * shape[axis, 5]), shape[axis, 1] + y * shape[axis, 4]
            if abs(slope) < 1e-7:
                high = high if abs(at) < REACH else low - 1.0
                continue
            one, other = (-REACH - at) / slope, (REACH - at) / slope
            low, high = max(low, min(one, other)), min(high, max(one, other))
        first, last = math.ceil(low), math.floor(high)
        if first > last:
            continue
        v, begin, end = int(window[1]) + y, int(window[0]) + first, int(window[0]) + last
        many = (last - first) // stride + 1
        if v < 0 or v >= height or begin < 0 or end >= width or many > CHUNK:
            return False
        if full + many > CHUNK:
            _add(flat, full, products, sums)
            full = 0
        line = flat[full:]
        _place(line, many, first, stride, y, shape, cells, side_px / (cells * blur))
        _read(line, many, corners, image[v, begin : end + 1], stride)
        if len(hidden) or len(tally):
            _number(line, many, cells)
        if len(hidden):
            _hide(line, many, hidden)
        _compare(line, many, side_px / blur, 1.0 / blur, level, cut)
        for k in range(many if len(tally) else 0):
            cell = int(line[16 * CHUNK + k])
            tally[cell, 0] += 1
            tally[cell, 1] += int(line[k])
        full += many
    _add(flat, full, products, sums)
    for i in range(_P):
        right[i], gram[i, :] = products[_P, i], products[i, :_P]
    sums[0] = products[_P, _P]
    return True


# Of many pixels in a row, flat[slot * CHUNK + k]: the compiler makes vectors of loops over arrays that are one.


@image_kernel
def _place(flat, many, first, stride, y, shape, cells, per):  # type: ignore[no-untyped-def]
    """Write 1: forward, 2: left [sides]; 3, 4: past the nearest corner of cells to the right and down [blurs], 5, 6:
    how steep an edge in that corner is there, 7, 8: how much of it is passed; 9: that corner's number."""
    half, one, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    three, sixth, outer = np.float32(3.0), np.float32(1.0 / 6.0), np.float32(1.5)
    a0 = np.float32(shape[0, 0] + y * (shape[0, 2] + y * shape[0, 5]))
    b0 = np.float32(shape[1, 0] + y * (shape[1, 2] + y * shape[1, 5]))
    a1, a2 = np.float32(shape[0, 1] + y * shape[0, 4]), np.float32(shape[0, 3])
    b1, b2 = np.float32(shape[1, 1] + y * shape[1, 4]), np.float32(shape[1, 3])
    across, middle, wide, per = np.float32(cells), np.float32(0.5 * cells + 1.0), np.float32(cells + 3), np.float32(per)
    begin, step = np.float32(first), np.float32(stride)
    for k in range(many):
        x = begin + step * np.float32(np.int32(k))
        a, b = a0 + x * (a1 + x * a2), b0 + x * (b1 + x * b2)
        right, down = middle + across * a, middle - across * b
        i, j = np.float32(np.int32(right + half)), np.float32(np.int32(down + half))
        s, t = (right - i) * per, (down - j) * per
        flat[CHUNK + k], flat[2 * CHUNK + k], flat[3 * CHUNK + k], flat[4 * CHUNK + k] = a, b, s, t
        p, q = max(outer - abs(s), zero), max(half - abs(s), zero)
        beyond = sixth * (p * p * p - three * q * q * q)
        flat[5 * CHUNK + k] = half * (p * p - three * q * q)
        flat[7 * CHUNK + k] = one - beyond if s > zero else beyond
        p, q = max(outer - abs(t), zero), max(half - abs(t), zero)
        beyond = sixth * (p * p * p - three * q * q * q)
        flat[6 * CHUNK + k] = half * (p * p - three * q * q)
        flat[8 * CHUNK + k] = one - beyond if t > zero else beyond
        flat[9 * CHUNK + k] = j * wide + i


@image_kernel
def _read(flat, many, corners, line, stride):  # type: ignore[no-untyped-def]
    """Write 10 to 13: the cells around the corner, 14: the grey."""
    for k in range(many):
        corner = corners[np.uint32(flat[9 * CHUNK + k])]
        flat[10 * CHUNK + k], flat[11 * CHUNK + k] = corner[0], corner[1]
        flat[12 * CHUNK + k], flat[13 * CHUNK + k] = corner[2], corner[3]
        flat[14 * CHUNK + k] = np.float32(line[k * stride]) - np.float32(128.0)


@image_kernel
def _number(flat, many, cells):  # type: ignore[no-untyped-def]
    """Write 16: the cell, row by row; the paper belongs to the cells at the rim."""
    for k in range(many):
        column = min(max(int(cells * (flat[CHUNK + k] + 0.5)), 0), cells - 1)
        row = min(max(int(cells * (0.5 - flat[2 * CHUNK + k])), 0), cells - 1)
        flat[16 * CHUNK + k] = np.float32(row * cells + column)


@image_kernel
def _hide(flat, many, hidden):  # type: ignore[no-untyped-def]
    """Write 15: 0 where a pixel does not count."""
    for k in range(many):
        flat[15 * CHUNK + k] = np.float32(0.0) if hidden[int(flat[16 * CHUNK + k])] else np.float32(1.0)


@image_kernel
def _covered(tally, hidden, cells):  # type: ignore[no-untyped-def]
    """Return the cells (C * C,) that are hidden, or show something else."""
    covered = np.zeros(cells * cells, np.bool_)
    for cell in range(cells * cells):
        covered[cell] = tally[cell, 1] < (1.0 - _COVERED) * tally[cell, 0] or (len(hidden) > 0 and hidden[cell])
    return covered


@image_kernel
def _compare(flat, many, by_shift, by_blur, level, cut):  # type: ignore[no-untyped-def]
    """Write 0 to 7: what the grey is linear in, 8: what of it is left; 9, 14: pattern and grey of what counts."""
    zero = np.float32(0.0)
    by_shift, by_blur, cut = np.float32(by_shift), np.float32(by_blur), np.float32(cut)
    bright, ahead, aside, contrast = (
        np.float32(level[0]),
        np.float32(level[1]),
        np.float32(level[2]),
        np.float32(level[3]),
    )
    for k in range(many):
        a, b, s, t = flat[CHUNK + k], flat[2 * CHUNK + k], flat[3 * CHUNK + k], flat[4 * CHUNK + k]
        steep_s, steep_t, past_s, past_t = (
            flat[5 * CHUNK + k],
            flat[6 * CHUNK + k],
            flat[7 * CHUNK + k],
            flat[8 * CHUNK + k],
        )
        here, right, below, beyond = (
            flat[10 * CHUNK + k],
            flat[11 * CHUNK + k],
            flat[12 * CHUNK + k],
            flat[13 * CHUNK + k],
        )
        grey, counts = flat[14 * CHUNK + k], flat[15 * CHUNK + k]
        by_s, by_t = (right + beyond * past_t) * steep_s, (below + beyond * past_s) * steep_t
        look = here + right * past_s + (below + beyond * past_s) * past_t
        rest = grey - (bright + ahead * a + aside * b + contrast * look)
        weight = counts if abs(rest) <= cut else zero
        forward, left = weight * by_shift * by_s, -weight * by_shift * by_t
        flat[k], flat[CHUNK + k], flat[2 * CHUNK + k], flat[3 * CHUNK + k] = (
            weight,
            weight * a,
            weight * b,
            weight * look,
        )
        flat[4 * CHUNK + k], flat[5 * CHUNK + k], flat[6 * CHUNK + k] = forward, left, a * left - b * forward
        flat[7 * CHUNK + k], flat[8 * CHUNK + k] = -weight * by_blur * (s * by_s + t * by_t), weight * rest
        flat[9 * CHUNK + k], flat[14 * CHUNK + k] = counts * look, counts * grey


@image_kernel
def _add(flat, many, products, sums):  # type: ignore[no-untyped-def]
    """Add the products of what ``_compare`` wrote."""
    for i in range(_P + 1):
        for j in range(0, i + 1, 3):  # three at once: what is in the last of them beyond i is not used
            one = two = three = np.float32(0.0)
            for k in range(many):
                p = flat[i * CHUNK + k]
                one += p * flat[j * CHUNK + k]
                two += p * flat[(j + 1) * CHUNK + k]
                three += p * flat[(j + 2) * CHUNK + k]
            products[i, j] += one
            products[i, j + 1] += two
            products[i, j + 2] += three
    n = x = y = xx = xy = yy = np.float32(0.0)
    for k in range(many):
        counts, look, grey = flat[15 * CHUNK + k], flat[9 * CHUNK + k], flat[14 * CHUNK + k]
        n += counts
        x += look
        y += grey
        xx += look * look
        xy += look * grey
        yy += grey * grey
    sums[1] += n
    sums[2] += x
    sums[3] += y
    sums[4] += xx
    sums[5] += xy
    sums[6] += yy


@image_kernel
def _likeness(sums):  # type: ignore[no-untyped-def]
    """Return the correlation of grey and pattern over all pixels that are not hidden."""
    n, x, y, xx, xy, yy = sums[1], sums[2], sums[3], sums[4], sums[5], sums[6]
    return (xy - x * y / n) / math.sqrt(max(xx - x * x / n, 1.0) * max(yy - y * y / n, 1.0))


@image_kernel
def _solve(gram, solution, squares):  # type: ignore[no-untyped-def]
    """Solve the normal equations, whose right side is in ``solution``; ``gram`` becomes its inverse. Return the sum of
    squares that is left of ``squares``."""
    factor, inverse, right = np.zeros((_P, _P)), np.zeros((_P, _P)), solution.copy()
    for i in range(_P):
        for j in range(i + 1):
            total = gram[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(total, 1e-7 * gram[i, i] + 1e-9))
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(_P):
        inverse[i, i] = 1.0 / factor[i, i]
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total -= factor[i, k] * inverse[k, j]
            inverse[i, j] = total / factor[i, i]
    for i in range(_P):
        solution[i] = 0.0
        for j in range(_P):
            total = 0.0
            for k in range(max(i, j), _P):
                total += inverse[k, i] * inverse[k, j]
            gram[i, j] = total
            solution[i] += total * right[j]
        squares -= solution[i] * right[i]
    return max(squares, 1e-6)


@image_kernel
def _covary(inverse, variance, side, psi, covariance):  # type: ignore[no-untyped-def]
    """Write the covariance (6,) of x, y [m; world] and psi [rad]: xx, xy, yy, x psi, y psi, psi psi."""
    c, s, area = math.cos(psi), math.sin(psi), side * side * variance
    ff, fl, ll = inverse[4, 4], inverse[4, 5], inverse[5, 5]
    covariance[0] = area * (c * c * ff - 2.0 * c * s * fl + s * s * ll)
    covariance[1] = area * (c * s * (ff - ll) + (c * c - s * s) * fl)
    covariance[2] = area * (s * s * ff + 2.0 * c * s * fl + c * c * ll)
    covariance[3] = side * variance * (c * inverse[4, 6] - s * inverse[5, 6])
    covariance[4] = side * variance * (s * inverse[4, 6] + c * inverse[5, 6])
    covariance[5] = variance * inverse[6, 6]


KERNELS: tuple[Any, ...] = (fit_tags,)  # that are called from Python
