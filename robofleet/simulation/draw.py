"""Draws robots into an image, and renews what lies below them: the kernels of ``camera.py``.

A tag's print is blurred exactly, by how much of a Gaussian lies in each of its cells: so its edges lie where they
should. Its paper, and its body, a disc below it, end in smooth steps as wide as the blur.
Arithmetic is in single precision: 0.2 micrometres of a plane's two metres.
"""

import math

import numpy as np

from robofleet.core.arrays import Array32
from robofleet.core.kernels import image_kernel, infinite_kernel
from robofleet.simulation.floor import BLACK, WHITE
from robofleet.tracking.projection import project
from robofleet.tracking.tags.families import pattern

_BODY_GREY = 70.0  # of a robot in full light
_MARGIN = 1.1  # around a robot: the scale at its edge is not that of its middle
_RAMP = math.sqrt(20.0)  # width of a smooth step [standard deviations of its blur]
_MOTION_PX = 0.7  # what moves further during an exposure is drawn at several instants
_MOST_INSTANTS = 64
_CHUNK = 128  # pixels of a row that are drawn at once: how much of each is tag, where that is on its print,
_COLUMN, _ROW, _COVER, _LIGHT = _CHUNK, 2 * _CHUNK, 3 * _CHUNK, 4 * _CHUNK  # how much is robot, and its grey times that
_RIM_CELLS = 2  # white, around a print
_FINE = 64  # steps of a normal distribution's tail, a standard deviation; after five nothing is left
_NORMAL = np.array([0.5 - 0.5 * math.erf(k / _FINE / math.sqrt(2.0)) for k in range(5 * _FINE)], np.float32)


@image_kernel
def renew(image, floor, noise, offset, boxes):  # type: ignore[no-untyped-def]
    """Let ``boxes`` (M, 4) of an image show the floor again, with new noise, which is stored with an ``offset``.

    A box: left, top, right, bottom; right and bottom are not part of it.
    """
    shift = np.int16(offset)
    for k in range(len(boxes)):
        left, top, right, bottom = boxes[k]
        for i in range(top, bottom):
            shown, lit, grain = image[i, left:right], floor[i, left:right], noise[i, left:right]
            for j in range(len(shown)):
                gray = np.int16(lit[j]) + np.int16(grain[j]) - shift
                shown[j] = min(max(gray, 0), 255)


@image_kernel
def draw(  # type: ignore[no-untyped-def]
    image, noise, offset, plane_x, plane_y, gain, black, blur_px, blurs, side, camera, eye, heights, further,
    body_radius, poses, velocities, offsets, shapes, shutter, seen, boxes,
):  # fmt: skip
    """Blend the prints ``seen``, and bodies below them, into an image; ``boxes`` (N, 4) become theirs.

    shapes (N, 4): lengths meant by lengths printed, along right and top; of a bowed print, by a point's squared way
    along it, how much further its ray goes than to the centre's height, and how much longer its way on the paper is,
    as shares [1/m^2].
    """
    exposure, line_time = shutter
    instants = np.empty((_MOST_INSTANTS, 6), np.float32)
    paper = side / 2 + side / (black.shape[1] - 2 * _RIM_CELLS)
    boxes[:] = 0
    for n in seen:
        u, v = _centre(camera, poses[n], offsets[n], heights[n])
        scale, finest = _scale(plane_x, plane_y, u, v, 1.0 + further[n, 0])
        sigma = min(max(blur_px * scale, blurs[0]), blurs[1])
        moved = math.hypot(velocities[n, 0], velocities[n, 1]) + abs(velocities[n, 2]) * side
        count = min(max(1, math.ceil(moved * exposure / (finest * _MOTION_PX))), _MOST_INSTANTS)
        aside = math.sqrt(2.0) * paper / min(shapes[n, 0], shapes[n, 1], 1.0)
        if body_radius > 0.0:  # the body is seen beside the tag, as it lies lower
            foot = math.hypot(poses[n, 0] - eye[0], poses[n, 1] - eye[1])
            off = math.hypot(offsets[n, 0], offsets[n, 1])
            aside = max(aside, body_radius + off + foot * (further[n, 1] - further[n, 0]))
        reach = _MARGIN * (aside + 0.5 * _RAMP * sigma + moved * exposure) / finest + 1.0
        _place(poses[n], velocities[n], offsets[n], 0.0, exposure, instants[:count])
        box = boxes[n]
        box[0], box[1] = max(0, int(u - reach)), max(0, int(v - reach))
        box[2], box[3] = min(image.shape[1], int(u + reach) + 2), min(image.shape[0], int(v + reach) + 2)
        _robot(
            image, noise, offset, plane_x, plane_y, gain, box, u, v, reach, eye, further[n], instants[:count],
            poses[n], velocities[n], offsets[n], shapes[n], exposure, line_time, black[n], side, sigma, paper,
            body_radius,
        )  # fmt: skip


@infinite_kernel
def centres(camera, poses, offsets, heights):  # type: ignore[no-untyped-def]
    """Return the pixels (N, 2) of the centres of tags that sit off their robots' by ``offsets``: forward, left [m]."""
    pixels = np.empty((len(poses), 2))
    for n in range(len(poses)):
        pixels[n, 0], pixels[n, 1] = _centre(camera, poses[n], offsets[n], heights[n])
    return pixels


@infinite_kernel
def _centre(camera, pose, offset, height):  # type: ignore[no-untyped-def]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * offset[0] - s * offset[1], pose[1] + s * offset[0] + c * offset[1]
    return project(camera, x, y, height)


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
def _robot(  # type: ignore[no-untyped-def]
    image, noise, offset, plane_x, plane_y, gain, box, u, v, reach, eye, further, instants, pose, velocity, tag_offset,
    shape, exposure, line_time, black, side, sigma, paper, body_radius,
):  # fmt: skip
    """Blend a robot, the mean of its ``instants``, into the disc in ``box`` that it can reach."""
    room, count = np.empty(5 * _CHUNK, np.float32), black.shape[0] - 2 * _RIM_CELLS
    for i in range(box[1], box[3]):
        if line_time > 0.0:
            _place(pose, velocity, tag_offset, (i - v) * line_time, exposure, instants)
        width = math.sqrt(max(reach * reach - (i - v) ** 2, 0.0))
        first, end = max(0, int(u - width)), min(image.shape[1], int(u + width) + 2)
        for left in range(first, end, _CHUNK):
            right = min(left + _CHUNK, end)
            room[_COVER:] = 0.0
            for k in range(len(instants)):
                _shape(
                    plane_x[i, left:right], plane_y[i, left:right], eye, further, instants[k], shape, paper,
                    body_radius, _RAMP * sigma, count / side, 0.5 * black.shape[0], room,
                )  # fmt: skip
                _print(black, side / (count * sigma), right - left, room)
            _blend(
                image[i, left:right], noise[i, left:right], offset, gain[i, left:right], 1.0 / len(instants), room
            )  # fmt: skip


@image_kernel
def _shape(  # type: ignore[no-untyped-def]
    plane_x, plane_y, eye, further, instant, shape, paper, body_radius, ramp, per_m, middle_cell, room
):
    """Fill how much of each pixel of a row is tag, and where on its print that is [cells, with the rim]; add tag and
    body to the cover, and the body's grey to the light. The compiler does eight pixels at once."""
    unit, middle = np.float32(1.0), np.float32(middle_cell)
    to_tag, to_body = np.float32(further[0]), np.float32(further[1])
    eye_x, eye_y = np.float32(eye[0]), np.float32(eye[1])
    tag_x, tag_y, c, s, body_x, body_y = instant[0], instant[1], instant[2], instant[3], instant[4], instant[5]
    edge, radius, per_ramp = np.float32(paper), np.float32(body_radius), np.float32(1.0 / ramp)
    to_right, to_top = np.float32(shape[0]), np.float32(shape[1])
    right_x, right_y, top_x, top_y = c * to_right, s * to_right, s * to_top, c * to_top
    sag, arc, bowed = np.float32(shape[2]), np.float32(shape[3]), shape[2] != 0.0
    per_cell, inside = np.float32(per_m), unit if body_radius > 0.0 else np.float32(0.0)
    for j in range(len(plane_x)):
        x, y = plane_x[j], plane_y[j]
        from_x, from_y = x - eye_x, y - eye_y
        d_x, d_y = x + from_x * to_tag - tag_x, y + from_y * to_tag - tag_y
        a, b = right_x * d_x + right_y * d_y, top_y * d_y - top_x * d_x
        if bowed:
            lower = sag * a * a
            a, b = a + lower * (c * from_x + s * from_y), b + lower * (c * from_y - s * from_x)
            a += arc * a * a * a
        tag = _step((edge - abs(a)) * per_ramp) * _step((edge - abs(b)) * per_ramp)
        d_x, d_y = x + from_x * to_body - body_x, y + from_y * to_body - body_y
        body = inside * (unit - tag) * _step((radius - np.sqrt(d_x * d_x + d_y * d_y)) * per_ramp)
        room[j] = tag
        room[_COLUMN + j], room[_ROW + j] = middle + a * per_cell, middle - b * per_cell
        room[_COVER + j] += tag + body
        room[_LIGHT + j] += body * np.float32(_BODY_GREY)


@image_kernel
def _print(black, per_blur, count, room):  # type: ignore[no-untyped-def]
    """Add the print's grey to the light. What lies beyond the next cell is taken for that one's."""
    unit, zero, most = np.float32(1.0), np.float32(0.0), np.float32(len(black) - 1.001)
    white, contrast, steep = np.float32(WHITE), np.float32(WHITE - BLACK), np.float32(per_blur)
    for j in range(count):
        if room[j] > zero:
            column, row = min(max(room[_COLUMN + j], unit), most), min(max(room[_ROW + j], unit), most)
            m, n = int(row), int(column)
            left, right = _beyond(column - np.float32(n), steep)
            above, below = _beyond(row - np.float32(m), steep)
            here, level = unit - left - right, unit - above - below
            dark = above * (left * black[m - 1, n - 1] + here * black[m - 1, n] + right * black[m - 1, n + 1])
            dark += level * (left * black[m, n - 1] + here * black[m, n] + right * black[m, n + 1])
            dark += below * (left * black[m + 1, n - 1] + here * black[m + 1, n] + right * black[m + 1, n + 1])
            room[_LIGHT + j] += room[j] * (white - contrast * dark)


@image_kernel
def _blend(image, noise, offset, gain, share, room):  # type: ignore[no-untyped-def]
    """Put a robot's row over floor and noise."""
    part, low, high = np.float32(share), np.float32(0.0), np.float32(255.0)
    shift, rounding = np.float32(offset), np.float32(0.5)
    for j in range(len(image)):
        hidden = room[_COVER + j] * part
        gray = np.float32(image[j]) * (np.float32(1.0) - hidden) + room[_LIGHT + j] * part * gain[j]
        gray += (np.float32(noise[j]) - shift) * hidden
        image[j] = np.uint8(np.int32(min(max(gray, low), high) + rounding))


@image_kernel
def _step(d):  # type: ignore[no-untyped-def]
    """Return the smooth step from 0 at d = -1/2 to 1 at 1/2."""
    t = min(max(d + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@image_kernel
def _beyond(at, per_blur):  # type: ignore[no-untyped-def]
    """Return how much of a point ``at`` in a cell [cells], blurred, lies before the cell and behind it."""
    fine, last, unit = np.float32(_FINE), np.float32(len(_NORMAL) - 2), np.float32(1.0)
    before, behind = min(at * per_blur * fine, last), min((unit - at) * per_blur * fine, last)
    i, j = int(before), int(behind)
    p, q = before - np.float32(i), behind - np.float32(j)
    return _NORMAL[i] + p * (_NORMAL[i + 1] - _NORMAL[i]), _NORMAL[j] + q * (_NORMAL[j + 1] - _NORMAL[j])


def cells(tag: int, family: str) -> Array32:
    """Return a tag (C, C), of 36h11 (12, 12), for ``draw``."""
    return np.pad(1.0 - pattern(tag, family), _RIM_CELLS).astype(np.float32)


KERNELS = (renew, draw, centres)  # that are called from Python
