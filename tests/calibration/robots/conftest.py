"""Drives whose truth is known: a simulated robot with a tag somewhere on it, driven by the excitation alone."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from robofleet.behaviours.excitation import Manoeuvre
from robofleet.calibration.robots.believed import prior
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.identification import Identification, identify
from robofleet.calibration.robots.information import Prior
from robofleet.calibration.robots.shooting import Shots
from robofleet.config.calibrated import TagOffset
from robofleet.config.load import load_config
from robofleet.drivers.simulated import SimulatedRobot
from robofleet.tracking.offset import tag_from_centre
from robofleet.vehicles.interface import DriverContext, Imperfections, Simulation, WheelSpeeds
from tests.behaviours.excited import Excited
from tests.robots import GTERNAL, WORN
from tests.shipped import PLATOON

MS, S = 1_000_000, 1_000_000_000
NO_GATE = 1e9  # rad/s^2: nothing stands between the commands and the wheels
TICK, LEAD, ENCODER = 33 * MS, 18 * MS, 20 * MS
LATE = replace(WORN, motor_lag=0.06, actuation_delay=0.043)
OFFSET = TagOffset(forward_m=0.0123, left_m=-0.0071, heading_deg=3.4)

Make = Callable[..., RobotDrive]


@pytest.fixture(scope="session")
def driven() -> Make:
    """Return what makes the drive of one robot: its faults, where its tag sits, and what its poses are worth."""
    return drive


def drive(
    imperfections: Imperfections = LATE,
    offset: TagOffset = OFFSET,
    seed: int = 1,
    noise: tuple[float, float] = (3e-5, math.radians(0.05)),
    lost: float = 0.0,
    late: int = 0,
    manoeuvres: Sequence[Manoeuvre] = (),
) -> RobotDrive:
    """``late``: a command comes up to so many nanoseconds after its tick."""
    rng = np.random.default_rng(seed)
    excitation = Excited(1, {"r1": manoeuvres} if manoeuvres else None)
    now_ns = 0
    start, own_rng = (0.2, -0.1, 0.5), np.random.default_rng(seed)
    simulation = Simulation(drive=GTERNAL, imperfections=imperfections, start=start, trouble=None, rng=own_rng)
    robot = SimulatedRobot(DriverContext(robot="r1", drive=GTERNAL, simulation=simulation, now_ns=lambda: now_ns))
    ticks = int(excitation.ends[0] * S) // TICK
    lateness = rng.integers(late, size=ticks) if late else np.zeros(ticks, int)
    events = [event for k in range(1, ticks) for event in ((k * TICK + int(lateness[k]), 2), (k * TICK - LEAD, 0))]
    events += [(k * ENCODER, 1) for k in range(ticks * TICK // ENCODER)]
    commands, poses, encoders, measured = [], [], [], []
    wheels, turned, since_ns = np.zeros(2), np.zeros(2), 0
    for now_ns, what in sorted(events):
        at_s, truth, reading = now_ns / S, robot.truth(), robot.read()
        if what == 0 and rng.random() >= lost:
            seen = tag_from_centre(*truth[:3], offset)
            poses.append((at_s, *(np.array(seen) + rng.normal(size=3) * (noise[0], noise[0], noise[1]))))
        elif what == 1:
            encoders.append((at_s, reading.left_angle, reading.right_angle))
            measured.append((at_s, *(turned + wheels * (now_ns - since_ns) / S)))
        elif what == 2:
            turned, since_ns = turned + wheels * (now_ns - since_ns) / S, now_ns
            at_s = now_ns // TICK * TICK / S
            wheels = excitation.tick(at_s, np.array([truth[:3]]), np.array([True]))[0][0]
            robot.write(WheelSpeeds(*wheels.tolist()))
            commands.append((at_s, *wheels))
    setpoints, seen_poses, counted, meant = (np.array(rows) for rows in (commands, poses, encoders, measured))
    columns = [part for rows in (setpoints, seen_poses, meant, counted) for part in (rows[:, 0], rows[:, 1:])]
    return RobotDrive("r1", *columns, 0.0, NO_GATE)


def shots(drive: RobotDrive) -> Shots:
    """Return a drive as the identification takes it."""
    return Shots(drive, loop_period_s=LATE.loop_period, battery_life_s=LATE.battery_life)


def believed() -> Prior:
    """Return what the shipped platoon believes of its first robot."""
    config = load_config(PLATOON)
    return prior(config, config.robots[0])


def found(drive: RobotDrive) -> Identification:
    """Return what a drive tells of its robot."""
    return identify([shots(drive)], believed())


@pytest.fixture(scope="session")
def worn(driven: Make) -> RobotDrive:
    """Return the drive of a robot with every fault."""
    return driven()


@pytest.fixture(scope="session")
def smooth(driven: Make) -> RobotDrive:
    """Return the drive of a robot that has lag and delay alone."""
    return driven(
        replace(
            LATE, speed_quantum=0.0, deadband=0.0, breakaway=0.0, wheel_gain_spread=0.0, wheel_base_spread=0.0,
            slip=0.0, top_speed_sag=0.0,
        )
    )  # fmt: skip
