"""How far a simulation with identified robots is from a recorded run: the same configuration, seed and commands.

Open loop: what the model predicts by the commands alone, on the recording, and on the simulation's own recording, where
it is right but for noise. Closed loop: the figures of both runs. Each figure has its resolution, below which nobody
cares; with that added to both, their ratio is the gap. Its interval comes from resampled pieces of both runs.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from robofleet.calibration.robots import believed, drive
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.held_out import HORIZONS_S
from robofleet.calibration.robots.shooting import Noise, Wheels, relative
from robofleet.calibration.store import CalibrationError
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.robots import Robot, StartPose
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Indices
from robofleet.core.clock import S
from robofleet.recording.measures import exposure_to_tick_ms, exposure_to_wheel_ms, status_at_ticks
from robofleet.recording.run import Recording, Run
from robofleet.reports.bounds import JUDGED_KEYS
from robofleet.reports.predicted import GapFigure, RobotGap
from robofleet.tracking.offset import centre_from_tag
from robofleet.vehicles.plant import built

_PIECE_S = 2.0  # that is resampled: longer than what it holds remembers
_RESAMPLED = 400
_INTERVAL = 2.5, 97.5  # percentiles
_RESOLUTION = {"mm": 0.5, "m": 5e-4, "deg": 0.5, "ms": 1.0, "rad/s": 0.1}
_OTHERS = 0.05  # of the mean, of a unit that has none
_BANDS_HZ = (0.2, 1.0), (1.0, 5.0), (5.0, 15.0)
_AFTER = "pose after {:g} s, by the commands"
_OWN = _AFTER.format(HORIZONS_S[-1])  # what tells most of a single robot
_SOURCES = "truth", "camera"  # of poses, that can be simulated here
_NOISE = Noise(position=1.0, heading=1.0, slip=5e-4, way=3e-4)


_Prediction = dict[float, tuple[Array, Array]]  # by its horizon [s]: instants (P,) [s], errors (P,) [mm]


@dataclass(frozen=True)
class _Pieces:
    """A figure's mean, or mean square, over each piece of a run."""

    name: str
    unit: str
    values: Array
    weights: Array
    squared: bool = False

    def value(self, chosen: Indices | slice = slice(None)) -> float:
        mean = float((self.values[chosen] * self.weights[chosen]).sum() / self.weights[chosen].sum())
        return math.sqrt(mean) if self.squared else mean


def simulated(config: Config, recording: Recording, calibrations: Sequence[RobotCalibration]) -> Config:
    """Return the configuration of the simulation: identified robots of the project's own plant, which start where they
    were seen first. What the controller believes of them stays as it was."""
    models = {each.robot: each.simulated for each in calibrations}
    starts = _starts(recording)

    def robot_like(robot: Robot) -> Robot:
        measured = robot.calibration or RobotCalibration(robot=robot.id)
        model = models.get(robot.id) or robot.vehicle.simulated
        if model is None:
            raise CalibrationError(
                f"{robot.id}: its vehicle has no `simulated`, and nobody identified it: robofleet identify"
            )
        start = starts.get(robot.id, robot.start)
        return robot.model_copy(
            update={
                "driver": "simulated", "settings": {}, "twin": None, "start": start,
                "calibration": measured.model_copy(update={"simulated": model}),
            }
        )  # fmt: skip

    update: dict[str, object] = {
        "robots": tuple(map(robot_like, config.robots)),
        "plant": type(config.plant)(),
        "faults": (),
    }
    if config.tracker.source not in _SOURCES or not all(camera.rendered for _, camera in config.camera_keys):
        update["tracker"] = config.tracker.model_copy(update={"source": "truth"})
    update["camera"] = config.camera.model_copy(update={"source": "simulated"})
    return config.model_copy(update=update)


def _starts(recording: Recording) -> dict[str, StartPose]:
    """Return where each robot stood when it was seen first, as its centre."""
    found = {}
    for robot, own in _drives(recording):
        x, y, psi = centre_from_tag(own.poses[0, 0], own.poses[0, 1], own.poses[0, 2], robot.tag_offset)
        found[robot.id] = StartPose(x_m=x, y_m=y, heading_deg=math.degrees(psi))
    return found


def _drives(recording: Recording) -> Iterator[tuple[Robot, RobotDrive]]:
    """Yield what each robot did that moved."""
    for row, robot in enumerate(recording.config.members):
        with suppress(CalibrationError):
            yield robot, drive.extract(recording, [row])[0]


def figures(
    recorded: Recording, simulation: Recording, seed: int = 0
) -> tuple[tuple[GapFigure, ...], tuple[RobotGap, ...]]:
    """Return every figure that both runs have, and each robot's own one; ``seed`` of the resampling."""
    rng = np.random.default_rng(seed)
    models = {robot.id: _model(simulation.config, robot) for robot in simulation.config.members}
    drawn = {robot.id: _model(simulation.config, robot, drawn=True) for robot in simulation.config.members}
    predictions, others = _predictions(recorded, models), _predictions(simulation, drawn)
    pooled = {pieces.name: pieces for pieces in (*_open_loop(others.values()), *_closed_loop(simulation))}
    found = [
        _compared(pieces, pooled[pieces.name], rng)
        for pieces in (*_open_loop(predictions.values()), *_closed_loop(recorded))
        if pieces.name in pooled
    ]
    own = [
        RobotGap(robot=robot, figure=_compared(mine, simulated_mine, rng))
        for robot, prediction in predictions.items()
        if robot in others
        for mine, simulated_mine in zip(_open_loop([prediction]), _open_loop([others[robot]]), strict=False)
        if mine.name == _OWN
    ]
    return tuple(found), tuple(own)


def _compared(pieces: _Pieces, other: _Pieces, rng: np.random.Generator) -> GapFigure:
    """Return a figure of both runs."""
    resampled = [
        _ratio(pieces.value(_drawn(pieces, rng)), other.value(_drawn(other, rng)), pieces) for _ in range(_RESAMPLED)
    ]
    ratio = _ratio(pieces.value(), other.value(), pieces)
    low, high = np.percentile(resampled, _INTERVAL).tolist()
    if ratio < 1.0:
        ratio, low, high = 1.0 / ratio, 1.0 / high, 1.0 / low
    return GapFigure(
        name=pieces.name, unit=pieces.unit, recorded=pieces.value(), simulated=other.value(), ratio=ratio, low=low,
        high=high,
    )  # fmt: skip


def _drawn(pieces: _Pieces, rng: np.random.Generator) -> Indices:
    while True:
        drawn: Indices = rng.integers(len(pieces.values), size=len(pieces.values))
        if pieces.weights[drawn].sum():
            return drawn


def _ratio(recorded: float, simulated: float, pieces: _Pieces) -> float:
    resolution = _RESOLUTION.get(pieces.unit, _OTHERS * abs(simulated) + 1e-9)
    return (abs(recorded) + resolution) / (abs(simulated) + resolution)


def _closed_loop(recording: Recording) -> Iterator[_Pieces]:
    """Yield the figures of one run, in pieces; only those that it has."""
    for pieces in _figures_of(recording):
        if pieces.weights.sum():
            yield pieces


def _figures_of(recording: Recording) -> Iterator[_Pieces]:
    run = Run(recording)
    if not len(run.ticks):
        return
    t = run.t
    for part in run.parts:
        for curve in (each for each in part.curves if each.key in JUDGED_KEYS or not each.is_figure):
            counts = run.counts if curve.counts is None else curve.counts
            values = np.abs(curve.values - (curve.asked or 0.0))
            name = curve.name.replace("_", " ") + ("" if curve.asked is None else " error")
            yield _cut(name, curve.unit, t, np.where(counts[:, None], values, np.nan))
    yield from _spectra(run)
    yield _cut("exposure to tick", "ms", t, exposure_to_tick_ms(run)[:, None])
    yield _cut("exposure to wheel", "ms", t, status_at_ticks(run, exposure_to_wheel_ms))


def _predictions(recording: Recording, models: Mapping[str, Wheels]) -> dict[str, _Prediction]:
    """Return how far each robot was from where the commands alone put it, after some seconds."""
    found = {}
    for robot, own in _drives(recording):
        shots, prediction = believed.shots(robot, own), {}
        for horizon_s in HORIZONS_S:
            at_s, predicted, measured = shots.ahead(models[robot.id], _NOISE, horizon_s)
            off = relative(measured, predicted)
            prediction[horizon_s] = at_s, 1e3 * np.hypot(off[:, 0], off[:, 1])
        found[robot.id] = prediction
    return found


def _open_loop(predictions: Iterable[_Prediction]) -> Iterator[_Pieces]:
    """Yield the errors of predictions of one robot, or of several together."""
    together = list(predictions)
    for horizon_s in HORIZONS_S if together else ():
        at_s, off = (np.concatenate(parts) for parts in zip(*(each[horizon_s] for each in together), strict=True))
        if len(at_s):
            yield _cut(_AFTER.format(horizon_s), "mm", at_s, off[:, None], squared=True)


def _model(config: Config, robot: Robot, *, drawn: bool = False) -> Wheels:
    """Return the model of a simulated robot; ``drawn``: with the errors that its run draws, which nobody knows."""
    simulation = slices.simulation(config, robot, None)
    known = replace(simulation.imperfections, wheel_gain_spread=0.0, wheel_base_spread=0.0)
    build = built(simulation.drive, simulation.imperfections if drawn else known, simulation.rng)
    return replace(
        believed.prior(config, robot).values,
        left_radius_m=build.wheel_radius * build.left_gain,
        right_radius_m=build.wheel_radius * build.right_gain,
        wheel_base_m=build.wheel_base,
        motor_lag_s=build.motor_lag,
        stop_lag_s=build.stop_lag,
        delay_s=config.lockstep.bus_delay_s + build.delay_ns / S,
    )


def _spectra(run: Run) -> Iterator[_Pieces]:
    """Yield how much the wheels' commands move in bands of frequency [rad/s, rms]."""
    tick_s = run.config.controller.tick_s
    wheels = np.stack([run.items["left_rad_s"], run.items["right_rad_s"]], axis=-1).reshape(len(run.t), -1)
    length = round(2.0 * _PIECE_S / tick_s)
    starts = [k for k in range(0, len(wheels) - length + 1, length) if run.counts[k : k + length].all()]
    if not starts:
        return
    window = np.hanning(length)[:, None]
    frequencies = np.fft.rfftfreq(length, tick_s)
    power = []
    for k in starts:
        piece = np.nan_to_num(wheels[k : k + length])
        spectrum = np.abs(np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)) ** 2
        power.append(2.0 * spectrum.mean(axis=1) / (length * (window**2).sum()))
    for low, high in _BANDS_HZ:
        inside = (frequencies >= low) & (frequencies < high)
        values = np.array([own[inside].sum() for own in power])
        yield _Pieces(f"wheel speeds, {low:g} to {high:g} Hz", "rad/s", values, np.ones(len(values)), squared=True)


def _cut(name: str, unit: str, at_s: Array, values: Array, *, squared: bool = False) -> _Pieces:
    """Cut values (K, n) at instants (K,) into pieces; NaN: none."""
    known = np.isfinite(values)
    used = np.where(known, values**2 if squared else values, 0.0).sum(axis=1)
    piece = ((at_s - at_s.min()) / _PIECE_S).astype(np.int64)
    weights = np.bincount(piece, known.sum(axis=1)).astype(np.float64)
    sums = np.bincount(piece, used)
    filled = weights > 0
    return _Pieces(name, unit, sums[filled] / weights[filled], weights[filled], squared=squared)
