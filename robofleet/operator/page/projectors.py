"""What pages of projectors are told: where their light falls, and what is around each robot."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from robofleet.config import slices
from robofleet.config.faults import did_you_mean
from robofleet.config.projectors import ProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.files import read_named
from robofleet.core.refusal import RefusedError
from robofleet.projection.disc import disc_radii
from robofleet.projection.model import Projector, gray_shares

_LARGEST_IMAGE = 1 << 26  # [bytes]
_IMAGES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}  # by their first bytes


def calibrated(config: Config, name: str = "") -> tuple[ProjectorSettings, ...]:
    """Return the projectors that can show a run: the named one, or all; RefusedError, which says what is missing."""
    by_name = {projector.name: projector for projector in config.projectors}
    if not by_name:
        raise RefusedError(
            f"the configuration of {config.arena.name} has no projector: write `projectors: [{{name: main, width: "
            "1920, height: 1080}]`, then run robofleet calibrate projector"
        )
    if name and name not in by_name:
        raise RefusedError(f"--projector: there is no projector '{name}': {did_you_mean(name, by_name)}")
    chosen = (by_name[name],) if name else config.projectors
    for projector in chosen:
        if projector.calibration is None:
            raise RefusedError(
                f"projector {projector.name} is not calibrated: run robofleet calibrate projector, and write its "
                "`calibration`"
            )
    return chosen


def background(config: Config) -> tuple[bytes, str]:
    """Return the image that fills the arena, and its media type; none is empty. RefusedError where it is no image."""
    file = config.projection.background
    if file is None:
        return b"", ""
    try:
        image = read_named(Path(file), _LARGEST_IMAGE)
    except OSError as error:
        raise RefusedError(f"projection.background: {file}: {error.strerror}") from error
    kind = next((kind for start, kind in _IMAGES.items() if image.startswith(start)), "")
    if not kind:
        raise RefusedError(f"projection.background: {file} is no image: name a PNG, JPEG or WebP")
    return image, kind


def veil(config: Config, name: str) -> bytes:
    """Return what darkens a projector where others light the same floor: black of some opacity, a PNG."""
    known = {
        projector.name: Projector.from_model(projector.calibration)
        for projector in config.projectors
        if projector.calibration is not None
    }
    opacity = 1.0 - gray_shares(known, name)
    picture = np.zeros((*opacity.shape, 4), np.uint8)
    picture[..., 3] = np.round(255.0 * opacity)
    return bytes(cv2.imencode(".png", picture)[1])


def described(config: Config) -> Iterator[dict[str, Any]]:
    """Yield each projector: what its page needs to draw on the floor."""
    for projector in config.projectors:
        optics = None
        if projector.calibration is not None:
            geometry = Projector.from_model(projector.calibration).geometry
            optics = {
                "focal_px": np.diag(geometry.K)[:2].tolist(),
                "centre_px": geometry.K[:2, 2].tolist(),
                "distortion": geometry.distortion.tolist(),
                "T_projector_world": np.linalg.inv(geometry.T_world_camera)[:3].tolist(),
                "delay_s": projector.calibration.delay_s,
            }
        yield {
            "name": projector.name,
            "width": projector.width,
            "height": projector.height,
            "optics": optics,
            "brightness": projector.brightness,
            "disc_gray": projector.disc_gray,
        }


def lit(config: Config) -> Iterator[dict[str, Any]]:
    """Yield of each robot what its halo needs: its disc, its tag's height, and how wheels move it."""
    for robot, radius in zip(config.bodies, disc_radii(config), strict=True):
        drive = slices.drive(robot)
        yield {
            "disc_radius_m": round(float(radius), 4),
            "tag_height_m": slices.tag_height_m(config, robot),
            "wheel_radius_m": drive.wheel_radius,
            "wheel_base_m": drive.wheel_base,
            "max_speed_m_s": drive.max_speed,
        }
