"""The greys of a tag's pixels as equations for its pose: what ``fit.py`` solves, one pass after another.

Each pixel in a tag's square is compared, at its own centre, with what the print shows there: its pattern, as blurred as
the image. Nothing is interpolated, so the error does not depend on how the edges lie to the rows of pixels.

An edge is blurred by a quadratic B-spline, which is three equal boxes in a row: pixel, defocus and motion are boxes, or
nearly so. Its one number is the box's width; its variance is a quarter of the width squared.

The grey of a pixel is linear in eight numbers: brightness, its slopes forward and left, contrast, and contrast times
offset forward, offset left, turn, and wider blur.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import image_kernel

REACH = 0.56  # half the fitted square [sides]: half of the white cell beyond the black rim
PARAMETERS = 8
SHAPED = 6  # more coefficients, of a tag's own shape
SLOTS, CHUNK = 16, 512  # numbers of a pixel; pixels that are computed at once
MOST_ROWS = 150  # of pixels along a side that are looked at
_FLAT = 1e-7  # a slope that is less is taken for this [sides/px]
_LANES = 16  # of the processor, at most: chunks are filled up to a multiple of it


def vertices(white: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return a code ((C + 3)^2,) for each corner of a print's cells (C, C), and of one row of corners around it.

    Of the four cells around a corner, black -1 and white 0: the upper left one, what is more to the right, below, and
    in the diagonal beyond these two. Each, plus 2, is an octal digit; the first one is the lowest.
    """
    cells = np.pad(white.astype(np.int32) - 1, 2)
    a, b, c, d = cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]
    four = np.stack([a, b - a, c - a, d - c - b + a], axis=-1).reshape(-1, 4) + 2
    return np.asarray(four @ 8 ** np.arange(4), np.float32)


@image_kernel
def accumulate(  # type: ignore[no-untyped-def]
    image, shape, window, corners, cells, hidden, tally, side_px, blur, level, cut, stride, rows, flat, products, sums,
    slope, shaped,
):  # fmt: skip
    """Add up the normal equations: ``products`` (9, 9) of the pixels' eight coefficients and what is left of their
    grey; and ``sums`` (6,) over all pixels: their number, the pattern, the grey, and the products of these two.

    level (4,): brightness, its slopes and the contrast so far; a grey that is off by more than ``cut`` does not count.
    shaped (6, 15), where it is not empty: the products of six coefficients more, with the nine above and with each
    other: of size, stretch and shear, and of the bows of a tag seen under ``slope`` (``mapping.sight_slope``); see
    ``shape.py``.
    rows (2, CHUNK) and flat (SLOTS * CHUNK,) are overwritten. Return whether the square is in the image.
    """
    products[:], sums[:], shaped[:] = 0.0, 0.0, 0.0
    height, width = image.shape
    top, left = int(window[1]), int(window[0])
    many_rows = (int(window[5]) - int(window[4])) // stride + 1
    if many_rows > CHUNK:
        return False
    _bound(rows, many_rows, int(window[4]), stride, shape, window)
    full = np.int64(0)  # with a literal, what is called below would be compiled twice; so it would with a second call
    for n in range(many_rows + 1):
        first, last = (int(rows[0, n]), int(rows[1, n])) if n < many_rows else (1, 0)
        y = int(window[4]) + n * stride
        v, begin, end = top + y, left + first, left + last
        many = (last - first) // stride + 1 if first <= last else 0
        if many > 0 and (v < 0 or v >= height or begin < 0 or end >= width or many > CHUNK):
            return False
        if full + many > CHUNK or n == many_rows:
            _add_up(
                flat, full, shape, corners, cells, hidden, tally, side_px, blur, level, cut, products, sums, slope,
                shaped,
            )  # fmt: skip
            full = np.int64(0)
        if many > 0:
            _read(flat[full:], many, first, stride, y, image[v, begin : end + 1])
            full += many
    return True


@image_kernel
def _bound(rows, many, begin, stride, shape, window):  # type: ignore[no-untyped-def]
    """Write the first and the last column that are in the tag's square, for each row of pixels."""
    for n in range(many):
        y = float(begin + n * stride)
        low, high = window[2], window[3]
        for axis in range(2):
            at, slope = shape[axis, 0] + y * (shape[axis, 2] + y * shape[axis, 5]), shape[axis, 1] + y * shape[axis, 4]
            slope = slope if abs(slope) > _FLAT else _FLAT
            first, other = (-REACH - at) / slope, (REACH - at) / slope
            low, high = max(low, min(first, other)), min(high, max(first, other))
        rows[0, n], rows[1, n] = np.ceil(low), np.floor(high)


@image_kernel
def _add_up(  # type: ignore[no-untyped-def]
    flat, full, shape, corners, cells, hidden, tally, side_px, blur, level, cut, products, sums, slope, shaped
):
    """Add the pixels that were read."""
    many = min(-(-full // _LANES) * _LANES, CHUNK)
    for k in range(full, many):
        flat[k], flat[CHUNK + k], flat[14 * CHUNK + k] = flat[0], flat[CHUNK], flat[14 * CHUNK]
    for k in range(many):
        flat[15 * CHUNK + k] = np.float32(1.0) if k < full else np.float32(0.0)
    _place(flat, many, shape, cells, side_px / (cells * blur))
    if len(hidden):
        for k in range(full):
            if hidden[_cell(flat[CHUNK + k], flat[2 * CHUNK + k], cells)]:
                flat[15 * CHUNK + k] = np.float32(0.0)
    if len(tally):
        for k in range(full):
            flat[10 * CHUNK + k] = np.float32(_cell(flat[CHUNK + k], flat[2 * CHUNK + k], cells))
    for k in range(many):
        flat[9 * CHUNK + k] = corners[np.uint32(flat[9 * CHUNK + k])]
    _compare(flat, many, side_px / blur, 1.0 / blur, level, cut)
    for k in range(full if len(tally) else 0):
        cell = int(flat[10 * CHUNK + k])
        tally[cell, 0] += 1
        tally[cell, 1] += int(flat[k])
    _multiply(flat, many, products)
    _sum(flat, many, sums)
    if len(shaped):
        _multiply_shaped(flat, many, slope, shaped)


# Of many pixels in a row, flat[slot * CHUNK + k]: the compiler makes vectors of loops over arrays that are one.


@image_kernel
def _read(flat, many, first, stride, y, line):  # type: ignore[no-untyped-def]
    """Write 0: the column, 1: the row, 14: the grey."""
    begin, row, middle = np.float32(first), np.float32(y), np.float32(128.0)
    if stride == 1:
        for k in range(many):
            flat[k], flat[CHUNK + k] = begin + np.float32(np.int32(k)), row
            flat[14 * CHUNK + k] = np.float32(line[k]) - middle
    else:
        for k in range(many):
            flat[k], flat[CHUNK + k] = begin + np.float32(np.int32(k * stride)), row
            flat[14 * CHUNK + k] = np.float32(line[k * stride]) - middle


@image_kernel
def _place(flat, many, shape, cells, per):  # type: ignore[no-untyped-def]
    """Write 1: forward, 2: left [sides]; 3, 4: past the nearest corner of cells to the right and down [blurs], 5, 6:
    how steep an edge in that corner is there, 7, 8: how much of it is passed; 9: that corner's number."""
    half, unit, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    three, sixth, outer = np.float32(3.0), np.float32(1.0 / 6.0), np.float32(1.5)
    a0, ax, ay = np.float32(shape[0, 0]), np.float32(shape[0, 1]), np.float32(shape[0, 2])
    axx, axy, ayy = np.float32(shape[0, 3]), np.float32(shape[0, 4]), np.float32(shape[0, 5])
    b0, bx, by = np.float32(shape[1, 0]), np.float32(shape[1, 1]), np.float32(shape[1, 2])
    bxx, bxy, byy = np.float32(shape[1, 3]), np.float32(shape[1, 4]), np.float32(shape[1, 5])
    across, middle, wide, per = np.float32(cells), np.float32(0.5 * cells + 1.0), np.float32(cells + 3), np.float32(per)
    last = np.int32(cells + 2)  # a map may be wild where no tag can be: its pixels are compared with the outermost row
    for k in range(many):
        x, y = flat[k], flat[CHUNK + k]
        a = a0 + x * (ax + x * axx + y * axy) + y * (ay + y * ayy)
        b = b0 + x * (bx + x * bxx + y * bxy) + y * (by + y * byy)
        right, down = middle + across * a, middle - across * b
        i, j = np.float32(_within(right + half, last)), np.float32(_within(down + half, last))
        s, t = (right - i) * per, (down - j) * per
        flat[CHUNK + k], flat[2 * CHUNK + k], flat[3 * CHUNK + k], flat[4 * CHUNK + k] = a, b, s, t
        p, q = max(outer - abs(s), zero), max(half - abs(s), zero)
        beyond = sixth * (p * p * p - three * q * q * q)
        flat[5 * CHUNK + k] = half * (p * p - three * q * q)
        flat[7 * CHUNK + k] = unit - beyond if s > zero else beyond
        p, q = max(outer - abs(t), zero), max(half - abs(t), zero)
        beyond = sixth * (p * p * p - three * q * q * q)
        flat[6 * CHUNK + k] = half * (p * p - three * q * q)
        flat[8 * CHUNK + k] = unit - beyond if t > zero else beyond
        flat[9 * CHUNK + k] = j * wide + i


@image_kernel
def _within(number, last):  # type: ignore[no-untyped-def]
    """Return a number, as an integer from 0 to ``last``."""
    return min(max(np.int32(number), np.int32(0)), last)


@image_kernel
def _cell(forward, left, cells):  # type: ignore[no-untyped-def]
    """Return the cell in which a place [sides] lies, row by row; the paper belongs to the cells at the rim."""
    column = min(max(int(cells * (forward + 0.5)), 0), cells - 1)
    row = min(max(int(cells * (0.5 - left)), 0), cells - 1)
    return row * cells + column


@image_kernel
def _compare(flat, many, by_shift, by_blur, level, cut):  # type: ignore[no-untyped-def]
    """Write 0 to 7: what the grey is linear in, 8: what of it is left; 9, 14: pattern and grey of what counts."""
    zero, two, eight, eighth = np.float32(0.0), np.float32(2.0), np.float32(8.0), np.float32(0.125)
    by_shift, by_blur, cut = np.float32(by_shift), np.float32(by_blur), np.float32(cut)
    bright, ahead = np.float32(level[0]), np.float32(level[1])
    aside, contrast = np.float32(level[2]), np.float32(level[3])
    for k in range(many):
        a, b, s, t = flat[CHUNK + k], flat[2 * CHUNK + k], flat[3 * CHUNK + k], flat[4 * CHUNK + k]
        steep_s, steep_t = flat[5 * CHUNK + k], flat[6 * CHUNK + k]
        past_s, past_t = flat[7 * CHUNK + k], flat[8 * CHUNK + k]
        grey, counts, four = flat[14 * CHUNK + k], flat[15 * CHUNK + k], flat[9 * CHUNK + k]
        three = np.float32(np.int32(eighth * four))
        higher = np.float32(np.int32(eighth * three))
        highest = np.float32(np.int32(eighth * higher))
        here, right = four - eight * three - two, three - eight * higher - two
        below, beyond = higher - eight * highest - two, highest - two
        by_s, by_t = (right + beyond * past_t) * steep_s, (below + beyond * past_s) * steep_t
        look = here + right * past_s + (below + beyond * past_s) * past_t
        rest = grey - (bright + ahead * a + aside * b + contrast * look)
        weight = counts if abs(rest) <= cut else zero
        forward, left = weight * by_shift * by_s, -weight * by_shift * by_t
        flat[k], flat[CHUNK + k], flat[2 * CHUNK + k] = weight, weight * a, weight * b
        flat[3 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k] = weight * look, forward, left
        flat[6 * CHUNK + k] = a * left - b * forward
        flat[7 * CHUNK + k], flat[8 * CHUNK + k] = -weight * by_blur * (s * by_s + t * by_t), weight * rest
        flat[9 * CHUNK + k], flat[14 * CHUNK + k] = counts * look, counts * grey


@image_kernel
def _multiply(flat, many, products):  # type: ignore[no-untyped-def]
    """Add the products of 0 to 8 with each other: the lower triangle, by squares of three."""
    three = 3 * CHUNK
    for i in range(0, PARAMETERS + 1, 3):
        for j in range(0, i + 1, 3):
            x, y = flat[i * CHUNK : i * CHUNK + three], flat[j * CHUNK : j * CHUNK + three]
            _multiply_three(x, y, many, products[i : i + 3, j : j + 3])


@image_kernel
def _multiply_three(x, y, many, products):  # type: ignore[no-untyped-def]
    """Add the products of three with three: each number that is loaded is used three times."""
    au = av = aw = bu = bv = bw = cu = cv = cw = np.float32(0.0)
    for k in range(many):
        a, b, c = x[k], x[CHUNK + k], x[2 * CHUNK + k]
        u, v, w = y[k], y[CHUNK + k], y[2 * CHUNK + k]
        au, av, aw = au + a * u, av + a * v, aw + a * w
        bu, bv, bw = bu + b * u, bv + b * v, bw + b * w
        cu, cv, cw = cu + c * u, cv + c * v, cw + c * w
    products[0, 0], products[0, 1], products[0, 2] = products[0, 0] + au, products[0, 1] + av, products[0, 2] + aw
    products[1, 0], products[1, 1], products[1, 2] = products[1, 0] + bu, products[1, 1] + bv, products[1, 2] + bw
    products[2, 0], products[2, 1], products[2, 2] = products[2, 0] + cu, products[2, 1] + cv, products[2, 2] + cw


@image_kernel
def _multiply_shaped(flat, many, slope, shaped):  # type: ignore[no-untyped-def]
    """Add the products of ``SHAPED`` more, which replace 9 to 14. A point that lies higher appears further along the
    ``slope``."""
    ahead, aside, three = np.float32(slope[0]), np.float32(slope[1]), 3 * CHUNK
    for k in range(many):
        a, b, forward, left = flat[CHUNK + k], flat[2 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k]
        steep = ahead * forward + aside * left
        flat[9 * CHUNK + k], flat[10 * CHUNK + k] = a * forward + b * left, a * forward - b * left
        flat[11 * CHUNK + k], flat[12 * CHUNK + k] = b * forward + a * left, a * a * steep
        flat[13 * CHUNK + k], flat[14 * CHUNK + k] = b * b * steep, a * b * steep
    for i in range(0, SHAPED, 3):
        x = flat[(9 + i) * CHUNK : (9 + i) * CHUNK + three]
        for j in range(0, PARAMETERS + 1 + SHAPED, 3):
            _multiply_three(x, flat[j * CHUNK : j * CHUNK + three], many, shaped[i : i + 3, j : j + 3])


@image_kernel
def _sum(flat, many, sums):  # type: ignore[no-untyped-def]
    n = x = y = xx = xy = yy = np.float32(0.0)
    for k in range(many):
        counts, look, grey = flat[15 * CHUNK + k], flat[9 * CHUNK + k], flat[14 * CHUNK + k]
        n += counts
        x += look
        y += grey
        xx += look * look
        xy += look * grey
        yy += grey * grey
    sums[0] += n
    sums[1] += x
    sums[2] += y
    sums[3] += xx
    sums[4] += xy
    sums[5] += yy


@image_kernel
def likeness(sums):  # type: ignore[no-untyped-def]
    """Return the correlation of grey and pattern over all pixels that are not hidden."""
    n, x, y, xx, xy, yy = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    return (xy - x * y / n) / math.sqrt(max(xx - x * x / n, 1.0) * max(yy - y * y / n, 1.0))
