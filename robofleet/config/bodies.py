"""Robots that cannot be: a length in millimetres, a wheel outside its body, a speed that no wheel gives."""

import math
from collections.abc import Iterator

from robofleet.config import units
from robofleet.config.robots import Robot, Vehicle
from robofleet.config.tree import Config

_LARGEST_MEASURED_RATIO = 1.5  # of a calibrated value to its vehicle's, or the other way round
_LARGEST_HELD_BACK_RATIO = 4.0  # of a robot's top speed to what its wheels are allowed
_ROUNDING = 1e-9


def complaints(config: Config) -> Iterator[tuple[str, str]]:
    """Yield what cannot be: (dotted path, what is wrong and which key it is most probably)."""
    for i, robot in enumerate(config.robots):
        path = f"robots.{i}.vehicle"
        found = [(f"{path}.{key}", message) for key, message in _shape(robot.vehicle)]
        yield from found or [(f"{path}.{key}", message) for key, message in _speed(robot.vehicle)]
        yield from ((f"robots.{i}.calibration.{key}", message) for key, message in _measured(robot))


def _shape(vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """Both wheels are inside the body's disc."""
    radius, half, body = vehicle.wheel_radius_m, vehicle.wheel_base_m / 2, vehicle.body_radius_m
    if math.hypot(radius, half) <= body * (1 + _ROUNDING):
        return
    disc = f"a body of body_radius_m {body:g}"
    if radius <= body and half <= body:
        yield "body_radius_m", f"{body:g} m leaves no room for the wheels: {math.hypot(radius, half):.3g} at least"
    elif radius >= body and half >= body:
        yield "body_radius_m", f"{body:g} m is less than a wheel's radius and half the wheel base: mend it"
    elif radius > body:
        yield (
            "wheel_radius_m",
            f"a wheel of {radius:g} m is larger than {disc}: mend one{units.meant(radius, body, 'wheel_radius_m')}",
        )
    else:
        base = vehicle.wheel_base_m
        message = f"wheels {base:g} m apart stand outside {disc}: mend one{units.meant(base, 2 * body, 'wheel_base_m')}"
        yield "wheel_base_m", message


def _speed(vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """The wheels can give the top speed; one of them may be held back."""
    most = vehicle.max_wheel_speed_rad_s * vehicle.wheel_radius_m
    if vehicle.max_speed_m_s > _LARGEST_HELD_BACK_RATIO * most:
        request = f"{vehicle.max_speed_m_s:g} m/s is far more than these wheels give, {most:.3g} m/s"
        yield "max_speed_m_s", f"{request}: lower it, or mend max_wheel_speed_rad_s or wheel_radius_m"


def _measured(robot: Robot) -> Iterator[tuple[str, str]]:
    """What was measured of a robot is near what its kind has."""
    if robot.calibration is None:
        return
    for key in ("wheel_radius_m", "wheel_base_m"):
        measured, nominal = getattr(robot.calibration, key), getattr(robot.vehicle, key)
        if measured is not None and not 1 / _LARGEST_MEASURED_RATIO <= measured / nominal <= _LARGEST_MEASURED_RATIO:
            hint = units.meant(measured, _LARGEST_MEASURED_RATIO * nominal, key)
            yield key, f"{measured:g} m was measured, its vehicle has {nominal:g}: mend one, or calibrate again{hint}"
