"""Blur, tone curve and noise of a board that is cast ray by ray: sharp squares, 36 rays a pixel, a lens's Gaussian."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from robofleet.calibration.lens.board import Board, BoardDetector, BoardView
from robofleet.calibration.lens.imaging import measure_imaging
from robofleet.calibration.lens.projection import Lens
from robofleet.config.calibrated import ImagingSettings
from robofleet.core.arrays import Array

BOARD = Board((7, 5))
LENS = Lens("pinhole", (480, 360), np.array([480.0, 480.0, 241.0, 179.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
BLACK, WHITE, NOISE = 25.0, 215.0, 2.5  # of the light, as a linear camera shows it; noise as the ray-caster's
RAYS, TEXELS_M, MARGIN = 6, 10_000, 200  # rays along a pixel


def linear(light: Array) -> Array:
    return light


def srgb(light: Array) -> Array:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1.0 / 2.4) - 0.055)


def photo(pose: Array, middle_px: float, corner_px: float, tone: Callable[[Array], Array]) -> BoardView:
    """Return a view of the board under a pose (6,); the blur grows with the squared distance from the middle."""
    width, height = LENS.size
    at = [(np.arange(n * RAYS) + 0.5) / RAYS - 0.5 for n in (width, height)]
    rays = np.stack([*np.meshgrid(*at), np.ones((height * RAYS, width * RAYS))], axis=-1)
    from_board = LENS.geometry.K @ np.column_stack([cv2.Rodrigues(pose[:3])[0][:, :2], pose[3:]])
    onto = rays @ np.linalg.inv(from_board).T
    texel = (onto[..., :2] / onto[..., 2:] * TEXELS_M + MARGIN - 0.5).astype(np.float32)
    size = (round(BOARD.squares[0] * BOARD.square_m * TEXELS_M), round(BOARD.squares[1] * BOARD.square_m * TEXELS_M))
    sheet = cv2.copyMakeBorder(
        BOARD.print.generateImage(size), MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_CONSTANT, value=255
    )
    white = cv2.remap(sheet, texel[..., 0], texel[..., 1], cv2.INTER_NEAREST, borderValue=255)
    light = BLACK + (WHITE - BLACK) / 255.0 * white.astype(np.float32)
    u, v = np.meshgrid(np.arange(width) - (width - 1) / 2.0, np.arange(height) - (height - 1) / 2.0)
    share = (u * u + v * v) / (((width - 1) / 2.0) ** 2 + ((height - 1) / 2.0) ** 2)
    widths = np.linspace(middle_px, corner_px, 1 if middle_px == corner_px else 7)
    blurred = [cv2.GaussianBlur(light, (0, 0), float(sigma) * RAYS) for sigma in widths]
    pixels = np.stack([image.reshape(height, RAYS, width, RAYS).mean((1, 3)) for image in blurred])
    step = share * (len(widths) - 1)
    near = [np.maximum(1.0 - np.abs(step - k), 0.0) for k in range(len(widths))]
    gray = (pixels * near).sum(0)
    gray = gray + NOISE * np.sqrt(0.5 + gray * 0.5 / 128.0) * np.random.default_rng(1).standard_normal(gray.shape)
    image = np.rint(255.0 * tone(gray / 255.0)).clip(0, 255).astype(np.uint8)
    view = BoardDetector(BOARD).detect("cast", image).view
    assert view is not None
    return view


def imaging(middle_px: float, corner_px: float, tone: Callable[[Array], Array]) -> ImagingSettings:
    turn = np.array([0.12, -0.2, 0.3])
    R, centre = cv2.Rodrigues(turn)[0], np.array([0.14, 0.10, 0.0])
    view = photo(np.concatenate([turn, [0.0, 0.0, 0.31] - R @ centre]), middle_px, corner_px, tone)
    found = measure_imaging(LENS, [view], np.array([LENS.pose(view)]), BOARD)
    assert found is not None
    return found


def variance(found: ImagingSettings, gray: float) -> float:
    assert found.read_noise_gray is not None
    assert found.shot_noise is not None
    return found.read_noise_gray**2 + found.shot_noise * gray


@pytest.mark.slow
@pytest.mark.parametrize(
    ("middle_px", "corner_px", "tone"),
    [
        (0.6, 1.0, srgb),
        *[(sigma, sigma, srgb) for sigma in (0.5, 0.9, 1.2)],
        *[(sigma, sigma, linear) for sigma in (0.5, 0.7, 0.9, 1.2)],
    ],
)
def test_blur_tone_and_noise_are_those_of_the_camera(
    middle_px: float, corner_px: float, tone: Callable[[Array], Array]
) -> None:
    found = imaging(middle_px, corner_px, tone)
    assert found.blur_px == pytest.approx(middle_px, rel=0.05)
    assert found.blur_edge_px == pytest.approx(corner_px, rel=0.05)
    black, half, white = (float(tone(np.array(x / 255.0))) for x in (BLACK, 0.5 * (BLACK + WHITE), WHITE))
    assert found.tone == pytest.approx((half - black) / (white - black) - 0.5, abs=0.02)  # sRGB: 0.136
    for light in (BLACK, WHITE):
        gray = 255.0 * float(tone(np.array(light / 255.0)))
        slope = float(tone(np.array((light + 0.5) / 255.0)) - tone(np.array((light - 0.5) / 255.0))) * 255.0
        true = slope**2 * NOISE**2 * (0.5 + 0.5 / 128.0 * light) + 1.0 / 12.0
        assert np.sqrt(variance(found, gray)) == pytest.approx(np.sqrt(true), rel=0.1)


def test_squares_that_are_too_small_say_nothing() -> None:
    width = LENS.size[0]
    corners = BOARD.corners
    pose = np.array([0.0, 0.0, 0.0, -0.14, -0.1, 1.2])  # 16 px a square
    view = BoardView(
        "far", corners, LENS.project(corners, pose)[0], np.arange(len(corners)), np.zeros((360, width), np.uint8)
    )
    assert measure_imaging(LENS, [view], np.array([pose]), BOARD) is None
