"""Draws robots into an image, row by row: the kernels of ``camera.py``.

A tag's print comes from a blurred texture, its body is a disc below it; both end in smooth steps as wide as the blur.
Arithmetic is in single precision: 0.2 micrometres of a plane's two metres.
"""

import math

import numpy as np

from robofleet.kernels import image_kernel
from robofleet.simulation.floor import TEXEL
from robofleet.tracking.photometric import CELLS

BLUR_PX = math.sqrt(0.5**2 + 1.0 / 12.0)  # standard deviation: lens, and a pixel's square

_BODY = 70.0  # grey of a robot in full light
_MARGIN = 1.1  # around a robot: the scale at its edge is not that of its middle
_RAMP = math.sqrt(20.0)  # width of a smooth step [standard deviations of its blur]
_MOTION_PX = 0.7  # what moves further during an exposure is drawn at several instants
_MOST_INSTANTS = 64


@image_kernel
def draw(  # type: ignore[no-untyped-def]
    image, noise, offset, plane_x, plane_y, gain, textures, looks, sigmas, side, eye, further, body_radius,
    poses, velocities, offsets, shutter, centres, seen,
):  # fmt: skip
    """Blend the prints ``seen``, and bodies below them, into background and noise; ``centres`` (N, 2) [px]."""
    exposure, line_time = shutter
    instants = np.empty((_MOST_INSTANTS, 6), np.float32)
    cover, light = np.empty(image.shape[1], np.float32), np.empty(image.shape[1], np.float32)
    at = np.empty((3, image.shape[1]), np.float32)
    paper = side / 2 + side / CELLS
    for n in seen:
        u, v = centres[n]
        scale, finest = _scale(plane_x, plane_y, u, v, 1.0 + further[n, 0])
        level = np.argmin(np.abs(sigmas - BLUR_PX * scale))
        look, sigma, texel = textures[looks[n], level], sigmas[level], TEXEL * sigmas[0]
        moved = math.hypot(velocities[n, 0], velocities[n, 1]) + abs(velocities[n, 2]) * side
        count = min(max(1, math.ceil(moved * exposure / (finest * _MOTION_PX))), _MOST_INSTANTS)
        aside = math.sqrt(2.0) * paper
        if body_radius > 0.0:  # the body is seen beside the tag, as it lies lower
            foot = math.hypot(poses[n, 0] - eye[0], poses[n, 1] - eye[1])
            off = math.hypot(offsets[n, 0], offsets[n, 1])
            aside = max(aside, body_radius + off + foot * (further[n, 1] - further[n, 0]))
        reach = _MARGIN * (aside + 0.5 * _RAMP * sigma + moved * exposure) / finest + 1.0
        _place(poses[n], velocities[n], offsets[n], 0.0, exposure, instants[:count])
        for i in range(max(0, int(v - reach)), min(image.shape[0], int(v + reach) + 2)):
            half = math.sqrt(max(reach * reach - (i - v) ** 2, 0.0))
            left, right = max(0, int(u - half)), min(image.shape[1], int(u + half) + 2)
            if right <= left:
                continue
            if line_time > 0.0:
                _place(poses[n], velocities[n], offsets[n], (i - v) * line_time, exposure, instants[:count])
            hidden, shown = cover[: right - left], light[: right - left]
            hidden[:], shown[:] = 0.0, 0.0
            for k in range(count):
                _look(
                    plane_x[i, left:right], plane_y[i, left:right], eye, further[n], instants[k], look,
                    np.float32(1.0 / texel), np.float32(1.0 / (_RAMP * sigma)), np.float32(paper),
                    np.float32(body_radius), at[:, : right - left], hidden, shown,
                )  # fmt: skip
            _blend(image[i, left:right], noise[i, left:right], offset, gain[i, left:right], hidden, shown, count)


@image_kernel
def _place(pose, velocity, offset, late, exposure, instants):  # type: ignore[no-untyped-def]
    """Fill ``instants`` (K, 6): x, y of the tag, its cosine and sine, x, y of the body, over an exposure."""
    for k in range(len(instants)):
        t = late + ((k + 0.5) / len(instants) - 0.5) * exposure
        bent = 0.5 * t * velocity[2]  # the velocity turns with the robot
        x, y = pose[0] + t * (velocity[0] - bent * velocity[1]), pose[1] + t * (velocity[1] + bent * velocity[0])
        psi = pose[2] + t * velocity[2]
        c, s = math.cos(psi), math.sin(psi)
        instants[k, 0], instants[k, 1] = x + c * offset[0] - s * offset[1], y + s * offset[0] + c * offset[1]
        instants[k, 2], instants[k, 3] = math.cos(psi + offset[2]), math.sin(psi + offset[2])
        instants[k, 4], instants[k, 5] = x, y


@image_kernel
def _scale(plane_x, plane_y, u, v, further):  # type: ignore[no-untyped-def]
    """Return metres a pixel at a pixel, or at the image's nearest one: the mean's, and where it is finest.

    further: a length at the height of interest, over the same one at the map's.
    """
    i, j = min(max(int(v), 1), plane_x.shape[0] - 1), min(max(int(u), 1), plane_x.shape[1] - 1)
    u_x, u_y = plane_x[i, j] - plane_x[i, j - 1], plane_y[i, j] - plane_y[i, j - 1]
    v_x, v_y = plane_x[i, j] - plane_x[i - 1, j], plane_y[i, j] - plane_y[i - 1, j]
    area, squares = abs(u_x * v_y - u_y * v_x), u_x * u_x + u_y * u_y + v_x * v_x + v_y * v_y
    finest = math.sqrt(0.5 * (squares - math.sqrt(max(squares * squares - 4.0 * area * area, 0.0))))
    return math.sqrt(area) * further, finest * further


@image_kernel
def _look(  # type: ignore[no-untyped-def]
    x, y, eye, further, instant, look, per_texel, ramp, paper, body_radius, at, cover, light
):
    """Add to ``cover`` (n,) how much of the floor a robot hides in a row, and its grey times that to ``light`` (n,).

    x, y (n,): where the rays meet the map's plane [m]. ``at`` (3, n): how much is tag, and where on the texture.
    """
    one, zero = np.float32(1.0), np.float32(0.0)
    to_tag, to_body = np.float32(further[0]), np.float32(further[1])
    eye_x, eye_y = np.float32(eye[0]), np.float32(eye[1])
    middle = np.float32(0.5 * (look.shape[0] - 1))
    tag, row, column = at[0], at[1], at[2]
    for j in range(len(x)):
        d_x = x[j] + (x[j] - eye_x) * to_tag - instant[0]
        d_y = y[j] + (y[j] - eye_y) * to_tag - instant[1]
        a, b = instant[2] * d_x + instant[3] * d_y, instant[2] * d_y - instant[3] * d_x
        tag[j] = _step((paper - abs(a)) * ramp) * _step((paper - abs(b)) * ramp)
        row[j], column[j] = middle - b * per_texel, middle + a * per_texel
    for j in range(len(x)):
        if tag[j] > zero:
            light[j] += tag[j] * _bilinear(look, row[j], column[j])
    if body_radius == zero:
        for j in range(len(x)):
            cover[j] += tag[j]
        return
    for j in range(len(x)):
        d_x = x[j] + (x[j] - eye_x) * to_body - instant[4]
        d_y = y[j] + (y[j] - eye_y) * to_body - instant[5]
        body = (one - tag[j]) * _step((body_radius - np.sqrt(d_x * d_x + d_y * d_y)) * ramp)
        light[j] += body * np.float32(_BODY)
        cover[j] += tag[j] + body


@image_kernel
def _blend(image, noise, offset, gain, cover, light, count):  # type: ignore[no-untyped-def]
    """Put a robot's row, of ``count`` instants, over background and noise."""
    share, low, high = np.float32(1.0 / count), np.float32(0.0), np.float32(255.0)
    shift, rounding = np.float32(offset), np.float32(0.5)
    for j in range(len(image)):
        hidden = cover[j] * share
        gray = np.float32(image[j]) * (np.float32(1.0) - hidden) + light[j] * share * gain[j]
        gray += (np.float32(noise[j]) - shift) * hidden
        image[j] = np.uint8(min(max(gray, low), high) + rounding) if hidden > low else image[j]


@image_kernel
def _step(d):  # type: ignore[no-untyped-def]
    """Return the smooth step from 0 at d = -1/2 to 1 at 1/2."""
    t = min(max(d + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@image_kernel
def _bilinear(texture, row, column):  # type: ignore[no-untyped-def]
    """Return the texture between its four texels; its rim goes on for ever."""
    last = np.float32(texture.shape[0] - 1.001)
    row, column = min(max(row, np.float32(0.0)), last), min(max(column, np.float32(0.0)), last)
    i, j = int(row), int(column)
    p, q = row - np.float32(i), column - np.float32(j)
    upper = texture[i, j] + q * (texture[i, j + 1] - texture[i, j])
    lower = texture[i + 1, j] + q * (texture[i + 1, j + 1] - texture[i + 1, j])
    return upper + p * (lower - upper)


KERNELS = (draw,)  # that are called from Python
