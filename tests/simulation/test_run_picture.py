"""What a simulated projector shows of a run."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from robofleet.behaviours import described
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import NOTE, POSES, SHOWING, TICK
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, FleetPoses, Note, NoteKind, RobotTick, TagPose, TickRecord
from robofleet.bus.messages import NOTE as NOTE_LAYOUT
from robofleet.config.files.names import SHIPPED
from robofleet.config.groups import descriptions
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.projection.model import Projector
from robofleet.safety.supervisor import Phase
from robofleet.simulation.run_picture import RunPicture
from robofleet.simulation.sources import SimulatedCamera
from tests.projection.projectors import on_floor

RATE_HZ = 60.0
GRAY = round(0.4 * 255)
RADIUS_M = 0.0619 + 0.02  # of the discs: half of a tag's paper, corner to corner, and the margin


class Shown:
    """A projector's pictures, and the bus whose run it shows."""

    def __init__(self, *overrides: str) -> None:
        self.config: Config = load_config(SHIPPED / "projector.yaml", ["projection.show=[]", *overrides])
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        bus = MemoryBus(self.config.arena.name, self.clock, 0)
        (settings,) = self.config.projectors
        self.run = RunPicture(self.config, settings, RATE_HZ, bus)
        assert settings.calibration is not None
        self.projector, self.delay_s = Projector.from_model(settings.calibration), settings.calibration.delay_s
        self.bus = bus
        self._tick, self._poses = bus.publisher(TICK), bus.publisher(POSES, self.config.camera.name)
        self.groups = descriptions(self.config)
        self._size = described.size(self.groups)

    def tick(self, *robots: tuple[float, float, float], wheels: float = 0.0, measured: bool = True) -> None:
        """Say a tick, now, of robots at poses, both wheels at a speed [rad/s]."""
        items = tuple(
            RobotTick(x, y, psi, 0, 0, 0, 0, wheels, wheels, 0, float(measured), 0, 0, 0, 0) for x, y, psi in robots
        )
        head = 1, 1, 1, 0, self.clock.now_ns(), 0, 0, 0, 0, 0, 0, Phase.RUNNING, 0, 0, 0, 0
        self._tick(TICK_RECORD.encode(TickRecord(*head, items, (np.nan,) * self._size)))

    def see(self, tag: int, x: float, y: float) -> None:
        pose = TagPose(tag, 0, 0, x, y, 0.0)
        self._poses(FLEET_POSES.encode(FleetPoses(1, 1, 1, 0, 0, 0, 0, 0, 0, (pose,))))

    def picture(self, after_s: float = 0.0) -> np.ndarray:
        picture = self.run.at(self.clock.now_ns() + round(after_s * S))
        assert picture is not None
        return picture

    def gray(self, picture: np.ndarray, x: float, y: float) -> int:
        u, v = np.rint(self.projector.pixels(on_floor(np.array([[x, y]])))[0]).astype(int)
        return int(picture[v, u])

    def discs(self, picture: np.ndarray) -> np.ndarray:
        """The middles (n, 2) on the floor of all that is grey, by x."""
        _, _, _, middles = cv2.connectedComponentsWithStats((picture == GRAY).astype(np.uint8))
        found = self.projector.floor(middles[1:])
        return found[np.argsort(found[:, 0])]


FOUR = [(-1.2, 0.0, 0.0), (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), (1.2, 0.0, 0.0)]


def test_nothing_is_shown_before_the_run() -> None:
    """So a calibration has the projector for itself."""
    shown = Shown()
    assert shown.run.at(shown.clock.now_ns()) is None


def test_discs_are_where_robots_will_be_when_their_light_falls() -> None:
    """0.2 m/s along x; from the tick's instant to the middle of the time for which the picture is lit."""
    shown = Shown("tracker.tag_height_m=0.001")
    shown.tick(*FOUR, wheels=0.2 / 0.016)
    waited_s = 0.02
    ahead_m = 0.2 * (waited_s + shown.delay_s + 0.5 / RATE_HZ)
    middles = shown.discs(shown.picture(waited_s))
    assert middles == pytest.approx(np.array(FOUR)[:, :2] + (ahead_m, 0.0), abs=1e-3)


def test_a_picture_is_drawn_of_what_was_known_then() -> None:
    shown = Shown("tracker.tag_height_m=0.001")
    shown.tick(*FOUR)
    shown.clock.advance_to(shown.clock.now_ns() + 10 * MS)
    shown.tick(*[(x, y + 0.5, psi) for x, y, psi in FOUR])
    before, now = shown.picture(-0.001), shown.picture()
    assert shown.discs(before)[:, 1] == pytest.approx(0.0, abs=1e-3)
    assert shown.discs(now)[:, 1] == pytest.approx(0.5, abs=1e-3)


def test_the_disc_covers_whatever_is_shown_and_the_halo_lies_around_it() -> None:
    shown = Shown("projection.show=[paths, references, halos]")
    path = next(shape for group in shown.groups for shape in group.shapes)
    (x, y), far = path.points[0].tolist(), path.points[len(path.points) // 2].tolist()
    shown.tick((x, y, 0.0), *FOUR[1:])
    picture = shown.picture()
    assert shown.gray(picture, x, y) == GRAY
    assert shown.gray(picture, *far) == 255
    assert shown.gray(picture, 0.4 - RADIUS_M - 0.008, 0.0) == 255  # towards the middle, where no shadow is
    assert shown.gray(picture, 0.4, 0.4) == 0


def test_a_disc_grows_while_its_robot_is_not_seen_until_all_is_grey() -> None:
    """It may be anywhere that it could have driven to; light must not hide it."""
    shown = Shown()
    shown.tick(*FOUR)
    seen = (shown.picture() == GRAY).mean()
    shown.clock.advance_to(shown.clock.now_ns() + S)
    shown.tick(*FOUR, measured=False)
    picture = shown.picture()
    assert (picture == GRAY).mean() > 2.0 * seen
    assert shown.gray(picture, 0.4, RADIUS_M + 0.17) == GRAY
    shown.clock.advance_to(shown.clock.now_ns() + 60 * S)
    shown.tick(*FOUR, measured=False)
    assert (shown.picture() == GRAY).mean() > 0.99


def test_robots_in_no_group_have_discs_where_they_were_seen() -> None:
    group = "{behaviour: platoon, robots: [r1, r2, r3], settings: {path: platoon, spacing_m: 0.25, path_rate: 0.0455}}"
    shown = Shown(f"groups=[{group}]", "tracker.tag_height_m=0.001")
    shown.see(4, 0.3, 0.7)
    shown.tick(*FOUR[:3])
    middles = shown.discs(shown.picture())
    assert middles[2] == pytest.approx([0.3, 0.7], abs=1e-3)
    assert len(middles) == 4


@pytest.mark.slow
def test_an_image_fills_the_arena(tmp_path: Path) -> None:
    """Its upper left corner is the arena's: the least x, and the greatest y."""
    quarters = np.repeat(np.repeat(np.array([[200, 0], [0, 90]], np.uint8), 50, axis=0), 80, axis=1)
    cv2.imwrite(str(tmp_path / "quarters.png"), quarters)
    image = f"projection.background={tmp_path}/quarters.png"
    shown = Shown("projection.show=[background]", image, "projectors.0.brightness=0.5")
    shown.tick(*[(0.0, 0.0, 0.0)] * 4)
    picture = shown.picture()
    assert [shown.gray(picture, x, y) for y in (0.6, -0.6) for x in (-1.0, 1.0)] == [100, 0, 0, 45]


def test_an_image_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.png").write_text("no image")
    config = load_config(SHIPPED / "projector.yaml", [f"projection.background={tmp_path}/notes.png"])
    ((key, line),) = SimulatedCamera.refusals(config)
    assert (key, line) == ("projection.background", f"{tmp_path}/notes.png is no image: name a PNG, JPEG or WebP")


def test_an_operator_switches_what_is_shown() -> None:
    """By the page's topic; words that are none change nothing."""
    shown = Shown("projection.show=[floor]")
    say = shown.bus.publisher(SHOWING)
    shown.tick(*FOUR)
    path = next(shape for group in shown.groups for shape in group.shapes)
    edge, on_path = (-1.6, 0.3), path.points[len(path.points) // 2].tolist()
    lit = []
    for words in "", "paths large", "paths walls", "floor":
        say(words.encode())
        picture = shown.picture()
        lit.append([shown.gray(picture, *point) == 255 for point in (edge, on_path)])
    assert lit == [[False, False], [False, True], [False, True], [True, False]]


def test_a_scripts_mark_is_shown_until_it_is_taken_away() -> None:
    group = "{behaviour: script, robots: [r1, r2, r3, r4]}"
    shown = Shown(f"groups=[{group}]", "projection.show=[paths]")
    note = shown.bus.publisher(NOTE, "script")
    shown.tick(*FOUR)
    lit = []
    for points in "[[-0.5, 0.5], [0.5, 0.5]]", "[]":
        mark = f'{{"kind": "Line", "name": "way", "points": {points}}}'
        note(NOTE_LAYOUT.encode(Note(1, 1, 1, NoteKind.MARK, mark.encode())))
        lit.append(shown.gray(shown.picture(), 0.0, 0.5))
    assert lit == [255, 0]
