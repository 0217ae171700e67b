"""How well ``robofleet identify`` finds the models of simulated robots whose parameters are drawn.

$ python -m tools.measure.robots.identification excitation

$ python -m tools.measure.robots.identification designed --seconds 40

$ python -m tools.measure.robots.identification platoon --runs 1

`excitation` is some of each kind of manoeuvre, `designed` what `robofleet calibrate drive` proposes for these robots
as they are shipped: the program also prints the standard deviations that were expected. `charges` is two excitations
at different charges of the battery.

Each run has four robots, each with parameters of its own: lag, delay, dead band, breakaway, slip, wheels. A case is one
parameter of one robot. Asked: 95 % of the told ones within two standard deviations; wheels within 1 %, lag and delay
within 2 ms, dead band within 5 %.
"""

import argparse
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np

from robofleet.calibration.robots import believed, drive
from robofleet.calibration.robots.design import Design, design
from robofleet.calibration.robots.identification import Identification, identify
from robofleet.calibration.robots.information import PARAMETERS
from robofleet.config import slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.recording.run import Recording
from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.vehicles.plant import built

CONFIG = Path("configs/platoon.yaml")
PLATOON_S = 60.0
SHORT_LIFE_S = 600.0  # of a battery, so that one drive takes a part of it
ALLOWED = {  # relative, or in the parameter's unit
    "left_radius_m": 0.01, "right_radius_m": 0.01, "wheel_base_m": 0.01, "motor_lag_s": 0.002, "delay_s": 0.002,
    "deadband_rad_s": 0.05,
}  # fmt: skip
ABSOLUTE = "motor_lag_s", "stop_lag_s", "delay_s", "encoder_offset_s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", choices=("excitation", "designed", "charges", "platoon"))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=40.0, help="of each robot's designed drive")
    parser.add_argument("--first", type=int, default=1, help="seed of the first run")
    given = parser.parse_args()
    errors: dict[str, list[float]] = defaultdict(list)
    sigmas: dict[str, list[float]] = defaultdict(list)
    missing: dict[str, int] = defaultdict(int)
    stated: list[Array] = []
    volumes: list[float] = []
    for seed in range(given.first, given.first + given.runs):
        for found, truth in results(driven(given.drive, seed, given.seconds)):
            determined = [name in found.determined for name in PARAMETERS]
            stated.append(np.where(determined, np.sqrt(np.diag(found.covariance)), np.nan))
            scale = found.prior.sigmas
            volumes.append(np.linalg.slogdet(found.covariance / np.outer(scale, scale))[1])
            for name in PARAMETERS:
                if name in found.determined:
                    value = getattr(found.wheels, name)
                    relative = 1.0 if name in ABSOLUTE or not truth[name] else truth[name]
                    errors[name].append((value - truth[name]) / relative)
                    sigmas[name].append((value - truth[name]) / found.sigma[name])
                else:
                    missing[name] += 1
            print(
                found.robot,
                seed,
                *(f"{e.horizon_s:g} s: {e.position_rms_mm:.3f} mm" for e in found.held_out),
                flush=True,
            )
    print(f"{given.drive}: parameter, cases told, not told, within 2 sigma, worst error, asked")
    for name in PARAMETERS:
        if errors[name]:
            inside = np.mean(np.abs(sigmas[name]) <= 2.0)
            worst = np.abs(errors[name]).max()
            print(
                f"{name:18} {len(errors[name]):3} {missing[name]:3} {inside:6.0%} {worst:.2g} {ALLOWED.get(name, '')}"
            )
        else:
            print(f"{name:18}   0 {missing[name]:3}")
    every = np.concatenate([np.array(values) for values in sigmas.values()])
    print(f"all {len(every)} cases: {np.mean(np.abs(every) <= 2.0):.1%} within 2 sigma")
    print(f"log det of the stated covariance, in the priors' standard deviations: {np.mean(volumes):.1f}")
    if given.drive == "designed":
        expected = np.array([each.expected for each in designs(given.seconds)])
        for name, now, then in zip(PARAMETERS, rms(expected), rms(np.array(stated)), strict=True):
            print(f"{name:18} expected {now:.3g} stated {then:.3g} ratio {then / now:.2f}")


def rms(values: Array) -> list[float]:
    found: list[float] = np.sqrt(np.nanmean(values**2, axis=0)).tolist()
    return found


def driven(kind: str, seed: int, seconds: float) -> list[Recording]:
    """Return lockstep recordings of four robots with drawn parameters, seen by the simulated camera."""
    if kind == "platoon":
        config = load_checked(CONFIG, [f"run.seed={seed}", f"run.duration_s={PLATOON_S:g}"], lockstep=True)
        lockstep = Lockstep(drawn(config, seed))
        lockstep.run()
        return [lockstep.recording]
    orders = ((), ("r4", "r3", "r2", "r1")) if kind == "charges" else ((),)
    return [_driven(kind, seed, seconds, order) for order in orders]


def _driven(kind: str, seed: int, seconds: float, order: tuple[str, ...]) -> Recording:
    config, count = drive.configure(CONFIG, order, [f"run.seed={seed}"], lockstep=True)
    if kind == "designed":
        config = drive.with_manoeuvres(config, {each.robot: each.manoeuvres for each in designs(seconds)})
        config = drive.lasting(config, count)
    life_s = SHORT_LIFE_S if kind == "charges" else None
    return drive.run(drawn(config, seed, life_s), Path(), lambda _: None, lockstep=True)


@cache
def designs(seconds: float) -> list[Design]:
    """Return what `robofleet calibrate drive` proposes for robots that nobody identified."""
    config, count = drive.configure(CONFIG, (), lockstep=True)
    lines = [drive.excitation(config).free_line_m(row) for row in range(count)]
    return [design(config, robot, seconds, line, count) for robot, line in zip(config.members, lines, strict=True)]


def drawn(config: Config, seed: int, battery_life_s: float | None = None) -> Config:
    rng = np.random.default_rng([seed, 33])
    return config.model_copy(update={"robots": tuple(_worn(robot, rng, battery_life_s) for robot in config.robots)})


def _worn(robot: Robot, rng: np.random.Generator, battery_life_s: float | None) -> Robot:
    assert robot.vehicle.simulated is not None
    deadband = rng.uniform(0.25, 0.8)
    simulated = robot.vehicle.simulated.model_copy(
        update={
            "motor_lag_s": rng.uniform(0.04, 0.12),
            "actuation_delay_s": rng.uniform(0.0, 0.03),
            "deadband_rad_s": deadband,
            "breakaway_rad_s": deadband + rng.uniform(0.1, 0.4),
            "slip_s_per_rad": rng.uniform(0.005, 0.04),
            "wheel_base_spread": 0.03,
            "top_speed_error": rng.uniform(-0.06, 0.03),
            "top_speed_sag": rng.uniform(0.05, 0.2),
            "battery_life_s": battery_life_s or robot.vehicle.simulated.battery_life_s,
        }
    )
    return robot.model_copy(update={"vehicle": robot.vehicle.model_copy(update={"simulated": simulated})})


def results(recordings: list[Recording]) -> list[tuple[Identification, dict[str, float]]]:
    config, found = recordings[0].config, []
    for robot in config.members:
        shots = []
        for recording in recordings:
            (own,) = drive.extract(recording, [[each.id for each in recording.config.members].index(robot.id)])
            shots.append(believed.shots(robot, own))
        nominal = robot.model_copy(update={"vehicle": load_checked(CONFIG, lockstep=True).robot(robot.id).vehicle})
        found.append((identify(shots, believed.prior(config, nominal)), true(config, robot)))
    return found


def true(config: Config, robot: Robot) -> dict[str, float]:
    simulation = slices.simulation(config, robot, None)
    build = built(simulation.drive, simulation.imperfections, simulation.rng)
    return {
        "left_radius_m": build.wheel_radius * build.left_gain,
        "right_radius_m": build.wheel_radius * build.right_gain,
        "wheel_base_m": build.wheel_base,
        "motor_lag_s": build.motor_lag,
        "stop_lag_s": build.stop_lag,
        "delay_s": config.lockstep.bus_delay_s + build.delay_ns * 1e-9,
        "deadband_rad_s": build.deadband,
        "breakaway_rad_s": build.breakaway,
        "top_speed_rad_s": build.max_wheel_speed,
        "top_speed_sag": build.top_speed_sag,
        "slip_s_per_rad": build.slip,
        "tag_forward_m": 0.0,
        "tag_left_m": 0.0,
        "tag_heading_rad": 0.0,
        "left_encoder": 1.0,
        "right_encoder": 1.0,
        "encoder_offset_s": config.lockstep.bus_delay_s,  # stamps count from the tick whose command is applied
    }


if __name__ == "__main__":
    main()
