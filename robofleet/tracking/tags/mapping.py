"""Where a pixel lies on a tag: quadratics of its column and row, good for the tag's square and a little beyond."""

import math

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import image_kernel
from robofleet.tracking.projection import project

_NODE = 0.6  # half the square whose nodes are projected [sides]
_ABOVE = 0.1  # the height of the point that shows under which slope a tag is seen [sides]


def quadratic() -> NDArray[np.float64]:
    """Return the matrix (6, 9) from values at the nodes of ``map_pixels`` to coefficients of 1, a, b, a^2, ab, b^2."""
    b, a = (np.mgrid[-1:2, -1:2] * _NODE).reshape(2, -1)
    return np.asarray(np.linalg.pinv(np.stack([np.ones(9), a, b, a * a, a * b, b * b], axis=1)), np.float64)


@image_kernel
def map_pixels(  # type: ignore[no-untyped-def]
    camera, line_time, side, height, tag_shape, to_quadratic, centre, psi, velocity, omega, nodes, bend, shape, window
):
    """Fill ``shape`` (2, 6): forward and left [sides] as quadratics of a pixel from the window's origin; ``window``
    (6,): origin, first and last column, first and last row. Return the centre's row, and the side [px]; 0: no map.

    tag_shape (8,): what the print is beyond a flat, level square of its side. Size, stretch and shear [shares]: forward
    and left of a point are (1 + size + stretch) a + shear b and (1 + size - stretch) b + shear a [sides]; how far the
    print's forward, and its left, rise above the horizontal [rad]; bows and twist [1/side]: a point lies higher than
    the tilted plane by bow a^2 + bow b^2 + twist a b [sides]. The centre stays where it is.
    nodes (6, 9) and bend (2, 6) are overwritten.
    """
    turned = side * complex(math.cos(psi), math.sin(psi))
    size, stretch, shear, tilt_a, tilt_b, bow_a, bow_b, twist = tag_shape
    cos_a, sin_a, cos_b, sin_b = math.cos(tilt_a), math.sin(tilt_a), math.cos(tilt_b), math.sin(tilt_b)
    u, v, z, missed = nodes[0], nodes[1], nodes[2:4], nodes[4:6]
    _, row = project(camera, centre.real, centre.imag, height)
    for n in range(9):
        a, b = (n % 3 - 1) * _NODE, (n // 3 - 1) * _NODE
        up = bow_a * a * a + bow_b * b * b + twist * a * b
        a, b = (1.0 + size + stretch) * a + shear * b, (1.0 + size - stretch) * b + shear * a
        arm = turned * complex(a * cos_a - b * sin_a * sin_b - up * sin_a * cos_b, b * cos_b - up * sin_b)
        point = centre + arm
        z_point = height + side * (a * sin_a + b * cos_a * sin_b + up * cos_a * cos_b)
        for late in range(2 if line_time > 0.0 else 1):
            if late:
                point += (velocity + 1j * omega * arm) * ((v[n] - row) * line_time)
            u[n], v[n] = project(camera, point.real, point.imag, z_point)
    scale = 0.5 / _NODE
    ua, va, ub, vb = (u[5] - u[3]) * scale, (v[5] - v[3]) * scale, (u[7] - u[1]) * scale, (v[7] - v[1]) * scale
    area = ua * vb - ub * va
    if not (16.0 < abs(area) < 1e8 and abs(u[4]) < 1e6 and abs(v[4]) < 1e6):
        return row, 0.0
    window[0], window[1] = round(u[4]), round(v[4])
    left, right, top, bottom = u[0], u[0], v[0], v[0]  # u.min() and its like take half a second to compile
    for n in range(1, 9):
        left, right, top, bottom = min(left, u[n]), max(right, u[n]), min(top, v[n]), max(bottom, v[n])
    window[2], window[3] = math.ceil(left - window[0]), math.floor(right - window[0])
    window[4], window[5] = math.ceil(top - window[1]), math.floor(bottom - window[1])
    # The linear map from pixels; what it misses at the nodes, as a quadratic of what it gives; and once more.
    m, n, o, p = vb / area, -ub / area, -va / area, ua / area
    for k in range(9):
        z[0, k], z[1, k] = m * (u[k] - u[4]) + n * (v[k] - v[4]), o * (u[k] - u[4]) + p * (v[k] - v[4])
        missed[0, k], missed[1, k] = (k % 3 - 1) * _NODE - z[0, k], (k // 3 - 1) * _NODE - z[1, k]
    bend[:] = 0.0
    for _ in range(2):
        for axis in range(2):
            k = bend[axis]
            for c in range(6):
                for at in range(9):
                    k[c] += to_quadratic[c, at] * missed[axis, at]
            for at in range(9):
                a, b = z[0, at], z[1, at]
                missed[axis, at] = (at % 3 - 1 if axis == 0 else at // 3 - 1) * _NODE - z[axis, at]
                missed[axis, at] -= k[0] + a * (k[1] + a * k[3] + b * k[4]) + b * (k[2] + b * k[5])
    x, y = u[4] - window[0], v[4] - window[1]
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
def sight_slope(camera, side, height, centre, shape, window):  # type: ignore[no-untyped-def]
    """Return how far forward and left of a tag's centre a point above it appears, in its height."""
    low_u, low_v = project(camera, centre.real, centre.imag, height)
    high_u, high_v = project(camera, centre.real, centre.imag, height + _ABOVE * side)
    slope = np.empty(2)
    for axis in range(2):
        s, difference = shape[axis], 0.0
        for u, v, sign in ((low_u, low_v, -1.0), (high_u, high_v, 1.0)):
            x, y = u - window[0], v - window[1]
            difference += sign * (x * (s[1] + x * s[3] + y * s[4]) + y * (s[2] + y * s[5]))
        slope[axis] = difference / _ABOVE
    return slope[0], slope[1]


@image_kernel
def on_level(forward, left, tilt, slope):  # type: ignore[no-untyped-def]
    """Return the step at a constant height, as a complex number, that looks like a step on the plane of a tilted tag
    that is seen under ``slope``."""
    cos_a, sin_a, cos_b, sin_b = math.cos(tilt[0]), math.sin(tilt[0]), math.cos(tilt[1]), math.sin(tilt[1])
    rise = forward * sin_a + left * cos_a * sin_b
    return complex(forward * cos_a - left * sin_a * sin_b + rise * slope[0], left * cos_b + rise * slope[1])


@image_kernel
def shift_map(shape, forward, left, spin):  # type: ignore[no-untyped-def]
    """Make ``shape`` that of a tag a short step further: forward, left [sides] and counter-clockwise by ``spin``."""
    c, s = math.cos(spin), math.sin(spin)
    shape[0, 0] -= forward
    shape[1, 0] -= left
    for k in range(6):
        a, b = shape[0, k], shape[1, k]
        shape[0, k], shape[1, k] = c * a + s * b, c * b - s * a
