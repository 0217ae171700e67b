"""The greys of a tag's pixels as equations for its pose: what ``fit.py`` solves, one pass after another.

Each pixel in a tag's square is compared, at its own centre, with what the print shows there: its pattern, as blurred as
the image. Nothing is interpolated, so the error does not depend on how the edges lie to the rows of pixels.

An edge is blurred by a quadratic B-spline, which is three equal boxes in a row: near enough a lens's Gaussian and a
pixel's square. Its one number is the box's width; its variance is a quarter of the width squared. A pixel sees its own
cell and the eight around it: that is exact as long as the blur reaches no further than a cell. Where the blur reaches
half a cell at most, four cells are enough. The camera's response then lifts what lies between black and white.

The grey of a pixel is linear in eight numbers: brightness, its slopes forward and left (of light, which white shows
more of than black), contrast, and contrast times offset forward, offset left, turn, and wider blur.
"""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import image_kernel

REACH = 0.56  # half the fitted square [sides]: half of the white cell beyond the black rim
PARAMETERS = 8
POSE = slice(4, 7)  # which of them are forward, left and turn
BLOCKS = 5  # along a tag's square: each block may have a light of its own
BLOCKED = PARAMETERS + 2  # coefficients of which products are added up by blocks
SHAPED = 6  # more coefficients, of a tag's own shape
SLOTS, CHUNK = 18, 512  # numbers of a pixel; pixels that are computed at once
MOST_ROWS = 150  # of pixels along a side that are looked at
_NARROW = 2.75  # blurs in a cell from which less than a thousandth reaches a pixel from beyond the nearest corner
_FLAT = 1e-7  # a slope that is less is taken for this [sides/px]
_LANES = 16  # of the processor, at most: chunks are filled up to a multiple of it


def neighbourhoods(white: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return a code ((C + 4)^2,) for each cell of a print (C, C), and of two rings of paper around it.

    It has a bit for each of the nine cells around the cell, row by row from the upper left one, 1 where it is black.
    """
    black = np.pad(~white, 3).astype(np.int32)
    n = len(white) + 4
    bits = [black[i : i + n, j : j + n] << (3 * i + j) for i in range(3) for j in range(3)]
    return np.asarray(np.sum(bits, axis=0), np.float32).ravel()


@image_kernel
def accumulate(  # type: ignore[no-untyped-def]
    image, shape, window, corners, cells, hidden, tally, side_px, blur, tone, level, cut, stride, rows, flat, products,
    sums, slope, shaped, blocks,
):  # fmt: skip
    """Add up the normal equations: ``products`` (9, 9) of the pixels' eight coefficients and what is left of their
    grey; and ``sums`` (6,) over all pixels: their number, the pattern, the grey, and the products of these two.

    level (4,): brightness, its slopes and the contrast so far; a grey that is off by more than ``cut`` does not count.
    shaped (6, 15), where it is not empty: the products of six coefficients more, with the nine above and with each
    other: of size, stretch and shear, and of the bows of a tag seen under ``slope`` (``mapping.sight_slope``); see
    ``shape.py``.
    rows (2, CHUNK) and flat (SLOTS * CHUNK,) are overwritten. Return whether the square is in the image.
    """
    products[:], sums[:], shaped[:], blocks[:] = 0.0, 0.0, 0.0, 0.0
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
                flat, full, shape, corners, cells, hidden, tally, side_px, blur, tone, level, cut, products, sums,
                slope, shaped, blocks,
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
    flat, full, shape, corners, cells, hidden, tally, side_px, blur, tone, level, cut, products, sums, slope, shaped,
    blocks,
):  # fmt: skip
    """Add the pixels that were read."""
    many = min(-(-full // _LANES) * _LANES, CHUNK)
    for k in range(full, many):
        flat[k], flat[CHUNK + k], flat[14 * CHUNK + k] = flat[0], flat[CHUNK], flat[14 * CHUNK]
    for k in range(many):
        flat[15 * CHUNK + k] = np.float32(1.0) if k < full else np.float32(0.0)
    per = np.float32(side_px / (cells * blur))  # blurs in a cell
    _place(flat, many, shape, cells, per)
    if len(hidden):
        for k in range(full):
            if hidden[_cell(flat[16 * CHUNK + k], flat[17 * CHUNK + k], cells)]:
                flat[15 * CHUNK + k] = np.float32(0.0)
    for k in range(many):
        flat[9 * CHUNK + k] = corners[np.uint32(flat[9 * CHUNK + k])]
    if per > _NARROW:
        _blend_narrow(flat, many, per)
    else:
        _blend(flat, many, per)
    _compare(flat, many, side_px / blur, 1.0 / blur, level, tone, cut)
    for k in range(full if len(tally) else 0):
        cell = _cell(flat[16 * CHUNK + k], flat[17 * CHUNK + k], cells)
        tally[cell, 0] += 1
        tally[cell, 1] += int(flat[k])
    _multiply(flat, many, products)
    _sum(flat, many, sums)
    if len(blocks):
        _multiply_in_blocks(flat, full, blocks)
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
    """Write 16: forward, 17: left [sides]; 12, 13: how far from its cell's left and upper edge [blurs]; 9: the cell's
    number."""
    a0, ax, ay = np.float32(shape[0, 0]), np.float32(shape[0, 1]), np.float32(shape[0, 2])
    axx, axy, ayy = np.float32(shape[0, 3]), np.float32(shape[0, 4]), np.float32(shape[0, 5])
    b0, bx, by = np.float32(shape[1, 0]), np.float32(shape[1, 1]), np.float32(shape[1, 2])
    bxx, bxy, byy = np.float32(shape[1, 3]), np.float32(shape[1, 4]), np.float32(shape[1, 5])
    across, middle, wide, per = np.float32(cells), np.float32(0.5 * cells + 2.0), np.float32(cells + 4), np.float32(per)
    last = np.int32(cells + 3)  # a map may be wild where no tag can be: its pixels are compared with the outermost row
    for k in range(many):
        x, y = flat[k], flat[CHUNK + k]
        a = a0 + x * (ax + x * axx + y * axy) + y * (ay + y * ayy)
        b = b0 + x * (bx + x * bxx + y * bxy) + y * (by + y * byy)
        right, down = middle + across * a, middle - across * b
        i, j = np.float32(_within(right, last)), np.float32(_within(down, last))
        flat[16 * CHUNK + k], flat[17 * CHUNK + k] = a, b
        flat[12 * CHUNK + k], flat[13 * CHUNK + k], flat[9 * CHUNK + k] = (
            (right - i) * per,
            (down - j) * per,
            j * wide + i,
        )


@image_kernel
def _blend(flat, many, per):  # type: ignore[no-untyped-def]
    """Write 3: the share of black that a pixel sees, 4, 5: how it grows to the right and down, 6: with the blur
    [1/blur]; of its cell and the eight around."""
    for k in range(many):
        s, t, code = flat[12 * CHUNK + k], flat[13 * CHUNK + k], np.int32(flat[9 * CHUNK + k])
        past_l, steep_l = _beyond(s)
        past_r, steep_r = _beyond(per - s)
        past_u, steep_u = _beyond(t)
        past_d, steep_d = _beyond(per - t)
        wide_l, wide_r = s * steep_l, (per - s) * steep_r
        n = np.float32(code >> 1 & 1)
        l, r = np.float32(code & 1) - n, np.float32(code >> 2 & 1) - n
        up, up_s, up_w = n + past_l * l + past_r * r, steep_r * r - steep_l * l, wide_l * l + wide_r * r
        n = np.float32(code >> 4 & 1)
        l, r = np.float32(code >> 3 & 1) - n, np.float32(code >> 5 & 1) - n
        here, by_s, by_w = n + past_l * l + past_r * r, steep_r * r - steep_l * l, wide_l * l + wide_r * r
        n = np.float32(code >> 7 & 1)
        l, r = np.float32(code >> 6 & 1) - n, np.float32(code >> 8 & 1) - n
        low, low_s, low_w = n + past_l * l + past_r * r, steep_r * r - steep_l * l, wide_l * l + wide_r * r
        up, up_s, up_w, low, low_s, low_w = up - here, up_s - by_s, up_w - by_w, low - here, low_s - by_s, low_w - by_w
        flat[3 * CHUNK + k] = here + past_u * up + past_d * low
        flat[4 * CHUNK + k] = by_s + past_u * up_s + past_d * low_s
        flat[5 * CHUNK + k] = steep_d * low - steep_u * up
        flat[6 * CHUNK + k] = by_w + past_u * up_w + past_d * low_w + t * steep_u * up + (per - t) * steep_d * low


@image_kernel
def _blend_narrow(flat, many, per):  # type: ignore[no-untyped-def]
    """As ``_blend``, of the four cells around the nearest corner."""
    half, zero, unit = np.float32(0.5) * per, np.float32(0.0), np.float32(1.0)
    for k in range(many):
        s, t, code = flat[12 * CHUNK + k], flat[13 * CHUNK + k], np.int32(flat[9 * CHUNK + k])
        code = code >> 1 if s > half else code
        code = code >> 3 if t > half else code
        s = s - per if s > half else s
        t = t - per if t > half else t
        share_s, steep_s = _beyond(abs(s))
        share_t, steep_t = _beyond(abs(t))
        past_s, past_t = share_s if s < zero else unit - share_s, share_t if t < zero else unit - share_t
        here, low = np.float32(code & 1), np.float32(code >> 3 & 1)
        right, low_right = np.float32(code >> 1 & 1) - here, np.float32(code >> 4 & 1) - low
        here, low, turn = here + past_s * right, low + past_s * low_right, low_right - right
        by_s, by_t = (right + past_t * turn) * steep_s, (low - here) * steep_t
        flat[3 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k] = here + past_t * (low - here), by_s, by_t
        flat[6 * CHUNK + k] = -(s * by_s + t * by_t)


@image_kernel
def _beyond(distance):  # type: ignore[no-untyped-def]
    """Return how much of the blur lies beyond an edge at a distance of 0 or more [blurs], and its density there."""
    zero, half, three = np.float32(0.0), np.float32(0.5), np.float32(3.0)
    p, q = max(np.float32(1.5) - distance, zero), max(half - distance, zero)
    return np.float32(1.0 / 6.0) * (p * p * p - three * q * q * q), half * (p * p - three * q * q)


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
def _compare(flat, many, by_shift, by_blur, level, tone, cut):  # type: ignore[no-untyped-def]
    """Write 0 to 7: what the grey is linear in, 8: what of it is left; 9, 14: pattern and grey of what counts."""
    zero, unit, four = np.float32(0.0), np.float32(1.0), np.float32(4.0)
    by_shift, by_blur, cut = np.float32(by_shift), np.float32(by_blur), np.float32(cut)
    bright, ahead = np.float32(level[0]), np.float32(level[1])
    aside, contrast = np.float32(level[2]), np.float32(level[3])
    share = np.float32(min(max(level[3] / max(level[0] + 128.0, 1.0), 0.0), 1.0))
    tone = np.float32(tone)
    for k in range(many):
        look, by_s, by_t, by_w = -flat[3 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k], flat[6 * CHUNK + k]
        a, b = flat[16 * CHUNK + k], flat[17 * CHUNK + k]
        grey, counts = flat[14 * CHUNK + k], flat[15 * CHUNK + k]
        curve = four * look * (unit + look)  # of the response: none in black and white
        steeper = tone * four * (unit + look + look) - unit
        look = look - tone * curve
        shade = unit + share * look
        a_lit, b_lit = a * shade, b * shade
        rest = grey - (bright + ahead * a_lit + aside * b_lit + contrast * look)
        weight = counts if abs(rest) <= cut else zero
        by = weight * steeper
        forward, left = by * by_shift * by_s, -by * by_shift * by_t
        flat[k], flat[CHUNK + k], flat[2 * CHUNK + k] = weight, weight * a_lit, weight * b_lit
        flat[3 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k] = weight * look, forward, left
        flat[6 * CHUNK + k] = a * left - b * forward
        flat[7 * CHUNK + k], flat[8 * CHUNK + k] = by * by_blur * by_w, weight * rest
        flat[9 * CHUNK + k], flat[14 * CHUNK + k] = counts * look, counts * grey
        flat[10 * CHUNK + k] = -weight * curve


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
        a, b, forward, left = flat[16 * CHUNK + k], flat[17 * CHUNK + k], flat[4 * CHUNK + k], flat[5 * CHUNK + k]
        steep = ahead * forward + aside * left
        flat[9 * CHUNK + k], flat[10 * CHUNK + k] = a * forward + b * left, a * forward - b * left
        flat[11 * CHUNK + k], flat[12 * CHUNK + k] = b * forward + a * left, a * a * steep
        flat[13 * CHUNK + k], flat[14 * CHUNK + k] = b * b * steep, a * b * steep
    for i in range(0, SHAPED, 3):
        x = flat[(9 + i) * CHUNK : (9 + i) * CHUNK + three]
        for j in range(0, PARAMETERS + 1 + SHAPED, 3):
            _multiply_three(x, flat[j * CHUNK : j * CHUNK + three], many, shaped[i : i + 3, j : j + 3])


@image_kernel
def _multiply_in_blocks(flat, many, blocks):  # type: ignore[no-untyped-def]
    """Add the products of 0 to 8, and of the response's coefficient, to those of the block in which a pixel lies."""
    values = np.empty(BLOCKED, np.float32)
    for k in range(many):
        if flat[k] > 0.0:
            column = min(max(int(BLOCKS * (0.5 + 0.5 / REACH * flat[16 * CHUNK + k])), 0), BLOCKS - 1)
            row = min(max(int(BLOCKS * (0.5 + 0.5 / REACH * flat[17 * CHUNK + k])), 0), BLOCKS - 1)
            for i in range(PARAMETERS + 1):
                values[i] = flat[i * CHUNK + k]
            values[BLOCKED - 1] = flat[10 * CHUNK + k]
            for i in range(BLOCKED):
                for j in range(i + 1):
                    blocks[row * BLOCKS + column, i, j] += values[i] * values[j]


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
