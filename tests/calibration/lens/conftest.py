"""A board before a camera whose lens is known: rendered, or as corners with noise; with formulas of its own."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.calibration.lens.board import Board, BoardView
from robofleet.core.arrays import Array

BOARD = Board()
TEXELS_M = 4000.0  # of the board's texture, a metre
SAMPLES = 2  # of a pixel, along each side
MARGIN = 40  # white around the print [texels]


def brown(slopes: Array, k: Array) -> Array:
    """Distort x/z, y/z: k1 k2 p1 p2 k3, and of a rational lens k4 k5 k6."""
    x, y = slopes[..., 0], slopes[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if len(k) > 5:
        radial = radial / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    return np.stack(
        [
            x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
            y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
        ],
        axis=-1,
    )


def kannala(slopes: Array, k: Array) -> Array:
    """Distort x/z, y/z as a fisheye: k1 k2 k3 k4."""
    r = np.maximum(np.linalg.norm(slopes, axis=-1, keepdims=True), 1e-12)
    theta = np.arctan(r)
    t2 = theta * theta
    return np.asarray(slopes / r * theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))))


@dataclass
class TrueCamera:
    """A lens that is known."""

    size: tuple[int, int] = (800, 600)
    focal: tuple[float, float] = (640.0, 642.0)
    centre: tuple[float, float] = (404.0, 297.0)
    distortion: Array = field(default_factory=lambda: np.array([-0.12, 0.03, 0.0005, -0.0004, -0.004]))

    @property
    def kind(self) -> str:
        return "fisheye" if len(self.distortion) == 4 else "pinhole"

    @property
    def values(self) -> Array:
        return np.array([*self.focal, *self.centre, *self.distortion])

    def pixels(self, points: Array) -> Array:
        """Project points (N, 3) [camera]."""
        bend = kannala if self.kind == "fisheye" else brown
        return bend(points[:, :2] / points[:, 2:], self.distortion) * self.focal + self.centre

    def slopes(self, pixels: Array, steps: int = 6) -> Array:
        """Return the rays of pixels, by Newton's steps; three reach 1e-5 px."""
        bend = kannala if self.kind == "fisheye" else brown
        wanted = (pixels - self.centre) / self.focal
        slopes, h = wanted.copy(), 1e-6
        for _ in range(steps):
            here = bend(slopes, self.distortion)
            (a, c), (b, d) = (((bend(slopes + h * e, self.distortion) - here) / h).T for e in np.eye(2))
            x, y = (wanted - here).T
            slopes += np.stack([d * x - b * y, a * y - c * x], axis=-1) / (a * d - b * c)[:, None]
        return slopes

    @cached_property
    def _rays(self) -> NDArray[np.float32]:
        width, height = self.size
        axes = [(np.arange(n * SAMPLES) + 0.5) / SAMPLES - 0.5 for n in (width, height)]
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        return self.slopes(grid, steps=3).astype(np.float32)

    def photo(
        self, pose: Array, rng: np.random.Generator, *, noise: float = 2.0, blur: float = 0.6, board: Board = BOARD,
        moved_px: float = 0.0,
    ) -> NDArray[np.uint8]:  # fmt: skip
        """Render the board at a pose (6,); ``moved_px``: how far it went during a rolling shutter's readout."""
        R = cv2.Rodrigues(pose[:3])[0]
        from_board = np.column_stack([R[:, :2], pose[3:]])
        H = np.linalg.inv(from_board).astype(np.float32)
        width, height = self.size
        shape = (height * SAMPLES, width * SAMPLES)
        plane = cv2.perspectiveTransform(self._rays.reshape(-1, 1, 2), H).reshape(*shape, 2)
        if moved_px:
            way = moved_px * pose[5] / self.focal[0] * (np.arange(shape[0]) / shape[0] - 0.5)
            plane[..., 0] -= way[:, None].astype(np.float32)
        texture = _texture(board)
        at = (plane * np.float32(TEXELS_M) - np.float32(0.5 - MARGIN)).clip(-1e4, 1e4)
        fine = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=110)
        image = cv2.resize(fine, self.size, interpolation=cv2.INTER_AREA).astype(np.float32)
        image = 25 + 0.8 * cv2.GaussianBlur(image, (0, 0), blur)
        return np.asarray(np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8))

    def view(
        self, name: str, pose: Array, noise_px: float, rng: np.random.Generator, board: Board = BOARD
    ) -> BoardView:
        """Return the corners inside the image, with noise."""
        points = board.corners
        pixels = self.pixels(points @ cv2.Rodrigues(pose[:3])[0].T + pose[3:])
        inside = ((pixels > 3) & (pixels < np.array(self.size) - 4)).all(axis=1)
        noisy = pixels[inside] + rng.normal(0, noise_px, (inside.sum(), 2))
        image = np.frombuffer(name.encode(), np.uint8).reshape(1, -1)
        return BoardView(name, points[inside], noisy, np.flatnonzero(inside), image)

    def pose(
        self, u: float, v: float, distance: float, left_deg: float, upper_deg: float, spin_deg: float = 0
    ) -> Array:
        """Return the pose of a board whose middle is seen at (u, v), left and upper edge away by these angles."""
        turns = (left_deg, 1), (-upper_deg, 0), (spin_deg, 2)
        y, x, z = (cv2.Rodrigues(np.radians(angle) * np.eye(3)[axis])[0] for angle, axis in turns)
        R = y @ x @ z
        ray = np.append(self.slopes(np.array([[u, v]]))[0], 1.0)
        return np.concatenate([cv2.Rodrigues(R)[0].ravel(), distance * ray - R @ BOARD.corners.mean(axis=0)])

    def good_poses(self, count: int, rng: np.random.Generator) -> list[Array]:
        """Return poses all over the image, the corners first, tilted every way."""
        (w, h), near = self.size, 0.44 * self.focal[0] / (0.6 * self.size[0])
        places = [(x, y) for x in (0.14, 0.86, 0.5) for y in (0.16, 0.84, 0.5)]
        tilts = [(30, 0), (-30, 0), (0, 30), (0, -30), (20, 20), (-20, 20), (0, 0)]
        poses = []
        for k in range(count):
            (x, y), distance = places[k % 9], near * rng.uniform(0.9, 1.4)
            poses.append(self.pose(x * w, y * h, distance, *tilts[k % 7], rng.uniform(-10, 10)))
        return poses

    def flat_poses(self, count: int, rng: np.random.Generator) -> list[Array]:
        """Return poses in the middle, hardly tilted: what determines nothing, and reprojects well."""
        w, h = self.size
        return [
            self.pose(
                w / 2 + rng.uniform(-40, 40), h / 2 + rng.uniform(-30, 30), rng.uniform(0.75, 1.0),
                *rng.normal(0, 1, 2), rng.uniform(-8, 8),
            )
            for _ in range(count)
        ]  # fmt: skip

    def floor_error_mm(
        self, slopes: Callable[[Array], Array], height_m: float = 2.5, tag_height_m: float = 0.08
    ) -> float:
        """Return how wrong places of tags are by another lens (its rays of pixels), rms over the image [mm].

        The camera hangs straight down; its pose is fitted to eight floor tags through the other lens, by Gauss and
        Newton on the places. This is what a laboratory would see.
        """
        w, h = self.size
        grid = np.stack(np.meshgrid(np.linspace(0, w - 1, 24), np.linspace(0, h - 1, 14)), axis=-1).reshape(-1, 2)
        middle = np.array([w - 1, h - 1]) / 2
        at = middle + 0.8 * middle * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
        floor, tags = self.slopes(at) * height_m, self.slopes(grid) * (height_m - tag_height_m)

        def places(pose: Array, pixels: Array, depth: float) -> Array:
            R = cv2.Rodrigues(pose[:3])[0]
            rays = np.column_stack([slopes(pixels), np.ones(len(pixels))]) @ R.T
            return np.asarray(pose[3:5] + rays[:, :2] * ((depth - pose[5]) / rays[:, 2])[:, None])

        pose = np.zeros(6)
        for _ in range(6):
            here = places(pose, at, height_m)
            J = np.stack([(places(pose + 1e-6 * e, at, height_m) - here).ravel() / 1e-6 for e in np.eye(6)], axis=1)
            pose += np.linalg.lstsq(J, (floor - here).ravel(), rcond=None)[0]
        wrong = places(pose, grid, height_m - tag_height_m) - tags
        return 1e3 * math.sqrt(float((wrong * wrong).sum(axis=1).mean()))


_TEXTURES: dict[Board, NDArray[np.uint8]] = {}


def _texture(board: Board) -> NDArray[np.uint8]:
    if board not in _TEXTURES:
        size = tuple(round(n * board.square_m * TEXELS_M) for n in board.squares)
        printed = board.print.generateImage(size, marginSize=0)
        framed = cv2.copyMakeBorder(printed, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_CONSTANT, value=255)
        _TEXTURES[board] = np.asarray(cv2.GaussianBlur(framed, (0, 0), 1.0), np.uint8)
    return _TEXTURES[board]


@pytest.fixture(scope="session")
def true_camera() -> TrueCamera:
    return TrueCamera()


@pytest.fixture(scope="session")
def fisheye() -> TrueCamera:
    return TrueCamera(focal=(420.0, 421.0), distortion=np.array([-0.02, 0.004, -0.002, 0.0004]))
