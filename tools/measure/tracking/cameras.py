"""Several cameras: poses where two views meet, one that is knocked, one that is unplugged, two trackers in real time.

    python -m tools.measure.tracking.cameras [seam] [knock] [unplug] [rate]     (all without a name)

``seam``: the shipped example, eight robots lap by lap through two views, in lockstep. ``knock``: two cameras above one
floor, one of them is turned by 0.3 degrees in mid-run; nothing on the floor tells it. ``unplug``: the example, one
camera stops for ever. ``rate``: the example in real time, a tracker process for each 1080p camera.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.recording.reading import read
from robofleet.recording.run import Recording, Run
from robofleet.runs.check import load_checked
from robofleet.runs.lockstep import Lockstep
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import NO_TAG, describe

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "configs" / "two-cameras.yaml"
MIDDLE_M = 0.35  # along x, from below a camera
SETTLED_S = 3.0
KNOCK_S, UNPLUG_S = 3.0, 22.0
OVERLAPPING = """cameras:
  - {name: one, model: overhead, width: 1280, height: 720, rate_hz: 30, trigger: tick}
  - {name: two, model: other, width: 1280, height: 720, rate_hz: 30, trigger: tick}
"""


class Errors(NamedTuple):
    """Of a run's estimates, all robots (K, N): the filter's position minus the true one [m]; who saw each."""

    t: Array  # (K,)
    off: Array  # (K, N, 2)
    at: Array  # (K, N, 2) true positions
    measured: NDArray[np.bool_]  # (K, N)


def overlapping(folder: Path) -> Path:
    """Write the platoon's laboratory with two cameras that both see all of its floor; returns its file."""
    platoon = (ROOT / "configs" / "platoon.yaml").read_text()
    (line,) = (line for line in platoon.splitlines(keepends=True) if line.startswith("camera:"))
    (folder / "cameras").mkdir()
    model = (ROOT / "configs" / "cameras" / "overhead.yaml").read_text()
    (folder / "cameras" / "other.yaml").write_text(model.replace("[0.0, 0.0, 2.5]", "[0.12, -0.08, 2.7]"))
    file = folder / "overlapping.yaml"
    file.write_text(platoon.replace(line, OVERLAPPING))
    return file


def driven(file: Path, *overrides: str) -> Recording:
    run = Lockstep(load_checked(file, overrides, lockstep=True))
    outcome = run.run()
    print(f"  {file.stem}: {outcome[0]}" + (f": {outcome[1]}" if outcome[1] else ""))
    return run.recording


def errors(recording: Recording) -> Errors:
    """Return how far the estimates were off at the ticks of a run."""
    run = Run(recording)
    assert run.truth is not None
    here = np.stack([run.items["x_m"], run.items["y_m"]], axis=-1)
    return Errors(run.t, here - run.truth[..., :2], run.truth[..., :2], run.items["measured"] > 0)


def news(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield what was told of the cameras: whose it is, and the sentence."""
    run = Run(recording)
    for row, camera in zip(run.news, run.news_of, strict=True):
        if row["tag"] == NO_TAG:
            yield str(camera), describe(int(row["event"]), NO_TAG, float(row["value"]), str(camera))


def in_view(config: Config, at: Array) -> NDArray[np.bool_]:
    """Return which cameras (C, K, N) have the tags of robots at places (K, N, 2) wholly in their images."""
    reach = config.tracker.tag_side_m
    sides = np.array([(dx, dy) for dx in (-reach, reach) for dy in (-reach, reach)])
    corners = at[..., None, :] + sides
    points = np.concatenate([corners, np.full((*corners.shape[:-1], 1), config.tracker.tag_height_m)], -1)
    found = []
    for view in config.views:
        geometry, size = CameraGeometry.from_model(view.camera.model), (view.camera.width, view.camera.height)
        seen = geometry.sees(points.reshape(-1, 3), size)
        found.append(seen.reshape(points.shape[:-1]).all(-1))
    return np.array(found)


class Seam(NamedTuple):
    seam_mm: float  # rms where both cameras see a robot
    middle_mm: float  # rms below the cameras, on the same straights
    step_mm: float  # largest change of the error from tick to tick where the cameras that see a robot change
    usual_mm: float  # the same of all other ticks: its 99th percentile
    crossings: int


def seam(recording: Recording) -> Seam:
    """Return the errors where the views meet, beside those in their middles."""
    config, figures = recording.config, errors(recording)
    settled = (figures.t >= SETTLED_S)[:, None]
    off = np.linalg.norm(figures.off, axis=-1)
    seen = in_view(config, figures.at)
    straight = np.abs(figures.at[..., 0]) < 1.8
    both = seen.all(axis=0) & settled & straight
    centres = [view.camera.model.T_world_camera.position_m[0] for view in config.views]  # type: ignore[union-attr]
    middle = np.any([np.abs(figures.at[..., 0] - x) < MIDDLE_M for x in centres], axis=0) & settled & straight
    step = np.linalg.norm(np.diff(figures.off, axis=0), axis=-1)
    changed = (seen[:, 1:] != seen[:, :-1]).any(axis=0) & settled[1:]
    near = changed.copy()
    for shift in (-2, -1, 1, 2):  # the tag's border, and the image's age
        near |= np.roll(changed, shift, axis=0)
    near &= settled[1:]
    both_rms, middle_rms = (float(1e3 * np.sqrt((off[where] ** 2).mean())) for where in (both, middle))
    usual = float(1e3 * np.percentile(step[~near & settled[1:]], 99))
    return Seam(both_rms, middle_rms, float(1e3 * step[near].max(initial=0.0)), usual, int(changed.sum()))


def measure_seam(duration_s: float) -> None:
    """Print the example's figures."""
    figures = seam(driven(EXAMPLE, f"run.duration_s={duration_s}"))
    print(f"  pose error: {figures.seam_mm:.3f} mm rms at the seam, {figures.middle_mm:.3f} mm in the middle: "
          f"{figures.seam_mm / figures.middle_mm:.2f} times")  # fmt: skip
    print(f"  largest step at {figures.crossings} borders of a view: {figures.step_mm:.3f} mm; "
          f"99 % of the other ticks: {figures.usual_mm:.3f} mm")  # fmt: skip


def measure_knock(duration_s: float) -> None:
    """Print what a knocked camera costs where another sees the same robots."""
    with TemporaryDirectory() as folder:
        file = overlapping(Path(folder))
        for axis, turn in enumerate(("[0.3, 0, 0]", "[0, 0.3, 0]", "[0, 0, 0.3]")):
            knock = f"cameras.{axis % 2}.simulated.knocks=[{{at_s: {KNOCK_S}, rotation_deg: {turn}}}]"
            recording = driven(file, f"run.duration_s={duration_s}", knock)
            figures = errors(recording)
            off, after = 1e3 * np.linalg.norm(figures.off, axis=-1), figures.t >= KNOCK_S + 1.0
            print(f"  {('one', 'two')[axis % 2]} turned by {turn} degrees: {[line for _, line in news(recording)]}")
            print(f"    pose error before: {_rms(off[(figures.t > 1) & (figures.t < KNOCK_S)])} mm rms, within 1 s: "
                  f"{off[(figures.t >= KNOCK_S) & ~after].max():.2f} mm at most, then {_rms(off[after])} mm rms, "
                  f"{off[after].max():.3f} mm at most")  # fmt: skip


def measure_unplug(duration_s: float) -> None:
    """Print who drives when a camera has gone for ever."""
    outage = f"cameras.0.simulated.outages=[{{kind: stalled, at_s: {UNPLUG_S}, duration_s: 1000}}]"
    recording = driven(EXAMPLE, f"run.duration_s={duration_s}", outage)
    figures = errors(recording)
    wheels = Run(recording).items["left_rad_s"]
    k = int(np.searchsorted(figures.t, UNPLUG_S))
    right = in_view(recording.config, figures.at)[1]
    later = int(np.searchsorted(figures.t, UNPLUG_S + 2.0))
    print(f"  {[line for _, line in news(recording)]}")
    for row, robot in enumerate(recording.config.members):
        moved = float(np.linalg.norm(np.diff(figures.at[later:, row], axis=0), axis=-1).sum())
        last = "stands" if np.abs(wheels[-30:, row]).max() < 1e-9 else "drives"
        print(f"  {robot.id}: {'seen by right' if right[k, row] else 'seen by left alone'} then; "
              f"{last} at the end, {moved:.2f} m after 2 s")  # fmt: skip


def measure_rate(duration_s: float) -> None:
    """Print the images a second of two 1080p trackers in real time."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [sys.executable, "-m", "robofleet", "run", str(EXAMPLE), "--quiet", "--out", str(out),
                   "--set", f"run.duration_s={duration_s}"]  # fmt: skip
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        print("\n".join(f"  {line}" for line in done.stderr.strip().splitlines()[-3:]))
        run = Run(read(out / "run.mcap"))
        for camera, frames in run.images.items():
            took_s = (frames[-1].exposure_ns - frames[0].exposure_ns) / 1e9
            work = np.percentile([frame.work_ns / 1e6 for frame in frames], (50, 99))
            print(f"  {camera}: {(len(frames) - 1) / took_s:.1f} Hz, {work[0]:.1f} ms an image (p99 {work[1]:.1f})")


def _rms(values: Array) -> str:
    return f"{np.sqrt((values**2).mean()):.3f}"


PARTS = {"seam": (measure_seam, 82.0), "knock": (measure_knock, 8.0), "unplug": (measure_unplug, 30.0),
         "rate": (measure_rate, 30.0)}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--duration", type=float, help="of each run [s]")
    options = parser.parse_args(arguments)
    for name in options.parts or PARTS:
        measure, duration_s = PARTS[name]
        print(f"{name}:")
        measure(options.duration or duration_s)


if __name__ == "__main__":
    main()
