"""Mistakes that beginners make: each ends with exit code 2 and one line that says where it is and how to mend it.

Nothing is started and nothing is written. ``«`` in an edit marks the place that the line must name.
"""

import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robofleet import cli
from robofleet.operator import run_command

ROOT = Path(__file__).parent.parent
PLATOON = (ROOT / "configs" / "platoon.yaml").read_text()
LAB = (ROOT / "configs" / "lab.yaml").read_text()
TWO = (ROOT / "configs" / "two-groups.yaml").read_text()
TRACK = (ROOT / "configs" / "track.yaml").read_text()
GO_TO = (ROOT / "configs" / "go-to.yaml").read_text()
(TRACKER,) = re.findall(r"^tracker:\n(?:  .*\n)+", PLATOON, re.MULTILINE)
PARKS = re.sub(  # go-to.yaml, whose robots have places to park: all but r2
    r"\{id: r(1|3|4|5|6|7|8|9|10), ",
    lambda robot: f"{robot[0]}park: {{x_m: {1.4 - 0.2 * int(robot[1]):.1f}, y_m: -0.8, heading_deg: 90}}, ",
    GO_TO.replace("run: {", "run: {end: park, "),
)
CSV = {"track.csv": (ROOT / "configs" / "track.csv").read_text()}
NO_FILE = "there is no such file"

Edit = tuple[str, str]


@dataclass(frozen=True)
class Mistake:
    """What is typed, and what the answer has to say. An edit is of ``platoon.yaml``, in the folder of the user."""

    name: str
    typed: str
    where: str  # what the line begins with; {at} is where « stands
    cure: str  # what it says
    edit: Edit | None = None
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    base: str = PLATOON
    alone: bool = True  # False: more is wrong, each in a line of its own


def edited(name: str, line: str, cure: str, old: str, new: str, **how: Any) -> Mistake:
    """Return a mistake in ``platoon.yaml`` that ``check`` finds at «; ``line``: what stands behind that place."""
    return Mistake(name, "check platoon.yaml", f"platoon.yaml:{{at}}: {line}", cure, (old, new), **how)


# fmt: off
MISTAKES = [
    # groups and their behaviours
    Mistake("a robot in two groups", "check two.yaml", "two.yaml:{at}: groups.1.robots.3: r1 is in groups.0 already",
        "a robot has one group", ("[r4, r5, r6]", "[r4, r5, r6, «r1]"), base=TWO),
    Mistake("a setting of another behaviour", "run two.yaml", "two.yaml:{at}: groups.1.settings.path_rate: unknown key",
        "known: centre_m, radius_m, speed_m_s", ("{radius_m: 0.4, ", "{radius_m: 0.4, «path_rate: 0.04, "), base=TWO),
    Mistake("a setting in its group, as in old files", "check two.yaml",
        "two.yaml:{at}: groups.0.spacing_m: is a setting of the behaviour platoon",
        "write it under `settings:` (groups.0.settings.spacing_m)",
        ("    settings: {path: platoon, spacing_m: 0.25, ", "    «spacing_m: 0.25\n    settings: {path: platoon, "),
        base=TWO),
    edited("a class that is no behaviour", "groups.0.behaviour: 'os:path' is not a class", "mend its name",
        "behaviour: platoon", "behaviour: «os:path"),
    Mistake("a goal outside the arena", "run go.yaml",
        "go.yaml:{at}: groups.0.settings.goals.r1: the distance of r1's goal from the edge is ",
        "move the goal inwards", ("r1: {x_m: -1.050", "r1: «{x_m: -1.590"), base=GO_TO),
    Mistake("two goals in one place", "check go.yaml",
        "go.yaml:{at}: groups.0.settings.goals.r2: the distance of the goals of r1 and r2, ", "move one of them",
        ("r2: {x_m: -0.849, y_m: -0.411", "r2: «{x_m: -1.050, y_m: 0.001"), base=GO_TO),
    Mistake("a goal that is no number", "check go.yaml", "go.yaml:{at}: groups.0.settings.goals.r2.x_m: ",
        "must be a finite number", ("r2: {x_m: -0.849, y_m: -0.411", "r2: {x_m: «.nan, y_m: -0.411"), base=GO_TO),
    Mistake("a table that is not sorted", "check track.yaml",
        "track.csv:4:1: groups.0.settings.references.r2.csv.2.0: 0.4 s does not come after 0.5 s",
        "sort the rows by time", ("name: track", "name: track"),
        files={"track.csv": CSV["track.csv"].replace("\n1.0,", "\n0.4,", 1)}, base=TRACK),
    Mistake("a table that is no text", "check track.yaml", "track.csv:1:1: is not UTF-8 text", "save the file as UTF-8",
        ("name: track", "name: track"), files={"track.csv": b"\xff\xfe\x00"}, base=TRACK),
    Mistake("way points too fast for the wheels", "check track.yaml",
        "track.yaml:{at}: groups.0.settings.references.r3.speed_m_s: speed_m_s is 0.9 m/s, must be at most ",
        "lower it", ("speed_m_s: 0.12", "speed_m_s: «0.9"), files=CSV, base=TRACK),
    Mistake("a path too fast for the wheels", "run track.yaml",
        "track.yaml:{at}: groups.0.settings.references.r1.path_rate: the fastest wheel along the path is ",
        "path_rate 0.177 fits", ("path_rate: 0.14", "path_rate: «1.4"), files=CSV, base=TRACK),
    Mistake("a park forgotten", "run platoon.yaml --set run.end=park", "platoon.yaml:6:5: robots.0.park: is missing",
        "run.end: park must know where r1 is to go", alone=False),
    Mistake("two parks in one place", "check go.yaml",
        "go.yaml:{at}: robots.1.park: the distance of the goals of r1 and r2, ", "move one of them",
        ("{id: r2, tag: 2, ", "{id: r2, tag: 2, park: «{x_m: 1.2, y_m: -0.8, heading_deg: 90}, "),
        base=PARKS),
    Mistake("go of no such robot", "go platoon.yaml r9=0,0,0", "r9=0,0,0: groups.0.robots.0: there is no",
        "r1, r2, r3, r4"),
    Mistake("go out of the arena", "go platoon.yaml r1=9,9,0", "r1=9,9,0: groups.0.settings.goals.r1: ", "inwards"),
    Mistake("go without numbers", "go platoon.yaml r1=a,b", "r1=a,b: write ROBOT=X,Y,DEG", "as r1=0.5,0.2,90"),
    Mistake("go to nan", "go platoon.yaml r1=nan,0,0", "r1=nan,0,0: write ROBOT=X,Y,DEG", "as r1=0.5,0.2,90"),
    Mistake("go of one robot twice", "go platoon.yaml r1=0,0,0 r1=1,0,0", "r1=1,0,0: r1 has a goal already", "once"),
    # the command line
    Mistake("no CONFIG", "run", "robofleet run: CONFIG is missing", "platoon.yaml"),
    Mistake("a name misspelt", "run plattoon.yaml", f"plattoon.yaml:1:1: {NO_FILE}", "did you mean platoon.yaml?"),
    Mistake("a name without its end", "run platoon", f"platoon:1:1: {NO_FILE}", "did you mean platoon.yaml?"),
    Mistake("a name in capitals", "run Platoon.YAML", f"Platoon.YAML:1:1: {NO_FILE}", "did you mean platoon.yaml?"),
    Mistake("the folder forgotten", "check mine.yaml", f"mine.yaml:1:1: {NO_FILE}", "did you mean lab/mine.yaml?",
        files={"lab/mine.yaml": PLATOON}),
    Mistake("a folder that is not there", "check labs/mine.yaml", f"labs/mine.yaml:1:1: {NO_FILE}",
        "did you mean lab/mine.yaml?", files={"lab/mine.yaml": PLATOON}),
    Mistake("a folder for a file", "run lab", "lab:1:1: is a folder", "name a file in it: lab/mine.yaml",
        files={"lab/mine.yaml": PLATOON}),
    Mistake("a command misspelt", "rum platoon.yaml", "robofleet: there is no command 'rum'", "did you mean 'run'?"),
    Mistake("an option misspelt", "run platoon.yaml --lockstp", "--lockstp: ", "did you mean --lockstep?"),
    Mistake("two configurations", "run platoon.yaml lab.yaml", "robofleet run: too many arguments, from 'lab.yaml' on",
        "robofleet run --help"),
    Mistake("a value that is no number", "run platoon.yaml --duration ten", "--duration: ", "must be a valid number"),
    Mistake("an option without its value", "run platoon.yaml --seed", "--seed: ", "needs a value"),
    Mistake("a duration below nothing", "run platoon.yaml --duration -5", "--set run.duration_s=-5.0: run.duration_s: ",
        "must be at least 0.001"),
    Mistake("a duration that is no number", "run platoon.yaml --duration nan",
        "--set run.duration_s=nan: run.duration_s: ", "number"),
    Mistake("a seed below nothing", "run platoon.yaml --seed -1", "--set run.seed=-1: run.seed: ",
        "must be at least 0"),
    Mistake("--set without =", "check platoon.yaml --set controller.alpha", "--set controller.alpha: ",
        "write KEY=VALUE"),
    Mistake("--set of no key", "check platoon.yaml --set controller.alfa=30",
        "--set controller.alfa=30: controller.alfa: ", "did you mean 'alpha'?"),
    Mistake("--set of a key without its parents", "check platoon.yaml --set alpha=30", "--set alpha=30: alpha: ",
        "did you mean controller.alpha=30?"),
    Mistake("--set of a behaviour's setting without its parents", "check platoon.yaml --set spacing_m=0.3",
        "--set spacing_m=0.3: spacing_m: ", "did you mean groups.0.settings.spacing_m=0.3?"),
    Mistake("--set of a setting at another place", "check platoon.yaml --set controller.spacing_m=0.3",
        "--set controller.spacing_m=0.3: ", "did you mean groups.0.settings.spacing_m=0.3?"),
    Mistake("--set of a misspelt key without its parents", "check platoon.yaml --set spacin_m=0.3",
        "--set spacin_m=0.3: spacin_m: ", "did you mean groups.0.settings.spacing_m=0.3?"),
    Mistake("--set of a key that is in several parts", "check platoon.yaml --set duration_s=5",
        "--set duration_s=5: duration_s: ", "did you mean run.duration_s=5?"),
    Mistake("--set of a robot by its name", "check platoon.yaml --set robots.r1.tag=7", "--set robots.r1.tag=7: ",
        "robots.0.tag"),
    Mistake("--set of a robot too many", "check platoon.yaml --set robots.4.tag=7", "--set robots.4.tag=7: ",
        "counted from 0"),
    Mistake("--set of another type", "check platoon.yaml --set controller.alpha=fast",
        "--set controller.alpha=fast: controller.alpha: ", "must be a number"),
    Mistake("--set without a key", "check platoon.yaml --set =3", "--set =3: ", "write KEY=VALUE"),
    Mistake("--set of half a key", "check platoon.yaml --set controller..alpha=3", "--set controller..alpha=3: ",
        "write KEY=VALUE"),
    Mistake("--set of no YAML", "check platoon.yaml --set run.duration_s=[", "--set run.duration_s=[: ", "YAML"),
    Mistake("--set of a tag twice", "check platoon.yaml --set robots.1.tag=1", "--set robots.1.tag=1: robots.1.tag: ",
        "robots.0's already"),
    Mistake("--set of no such driver", "check platoon.yaml --set robots.1.driver=nosuch",
        "--set robots.1.driver=nosuch: robots.1.driver: ", "nosuch"),
    Mistake("--set of no such camera", "check platoon.yaml --set camera.source=no.such:Camera",
        "--set camera.source=no.such:Camera: camera.source: ", "no.such"),
    Mistake("--set of a path rate too fast", "check platoon.yaml --set groups.0.settings.path_rate=0.075",
        "--set groups.0.settings.path_rate=0.075: groups.0.settings.path_rate: the fastest wheel", "fits"),
    Mistake("--out that holds something", "run platoon.yaml --lockstep --out .", "--out: . ", "name another folder"),
    Mistake("--out that is a file", "run platoon.yaml --lockstep --out platoon.yaml", "--out: platoon.yaml ",
        "name another folder"),
    Mistake("--out where nothing can be made", "run platoon.yaml --lockstep --out /proc/run", "--out: /proc/run ",
        "name another folder"),
    Mistake("--faults misspelt", "run platoon.yaml --faults losy.yaml", f"losy.yaml:1:1: {NO_FILE}",
        "did you mean lossy.yaml?", files={"lossy.yaml": "faults: []\n"}),
    Mistake("--faults without faults", "run platoon.yaml --lockstep --faults platoon.yaml", "platoon.yaml:", "faults"),
    Mistake("--faults of no robot", "run platoon.yaml --lockstep --faults f.yaml",
        "f.yaml:1:38: faults.0.robot: there is no robot 'r9'", "known: r1, r2, r3, r4",
        files={"f.yaml": "faults: [{kind: pose_dropout, robot: r9, at_s: 1, duration_s: 1}]\n"}),
    Mistake("a page of a lockstep run", "run platoon.yaml --lockstep --web", "--web: ",
        "leave --web or --lockstep out"),
    Mistake("a page for others of a lockstep run", "run platoon.yaml --web-host ::1 --lockstep", "--web-host: ",
        "a lockstep run ends too soon for a page"),
    Mistake("a page at another computer's address", "run platoon.yaml --web-host 198.51.100.7",
        "--web-host 198.51.100.7: Cannot assign requested address", "name an address of this machine"),
    Mistake("a page at every address", "run platoon.yaml --web-host 0.0.0.0", "--web-host 0.0.0.0: ",
        "name one of this machine's addresses"),
    Mistake("stop of no arena", "stop platoon", "no arena has a run", "robofleet run CONFIG"),
    Mistake("hold with nothing running", "hold", "no arena has a run", "robofleet run CONFIG"),
    Mistake("web with nothing running", "web", "no arena has a run", "robofleet run CONFIG"),
    Mistake("projecting with nothing running", "project", "no arena has a run", "robofleet run CONFIG"),
    Mistake("projecting without a projector", "project platoon.yaml", "the configuration of platoon has no projector",
        "write `projectors: [{name: main, width: 1920, height: 1080}]`"),
    Mistake("report of a configuration", "report platoon.yaml", "platoon.yaml: is not a recording",
        "name a run's folder"),
    Mistake("replay of a configuration", "replay platoon.yaml", "platoon.yaml: is not a recording",
        "name a run's folder"),
    Mistake("repair of a configuration", "repair platoon.yaml", "platoon.yaml: is not a recording",
        "name a run's folder"),
    Mistake("report of no run", "report runs/today", "runs/today: ", "name a run's folder"),
    Mistake("report of an empty folder", "report runs", "runs/run.mcap: ", "name a run's folder",
        files={"runs/x/summary.json": "{}"}),
    Mistake("run of a recording", "run runs/run.mcap", "runs/run.mcap:1:1: is a recording", "robofleet report",
        files={"runs/run.mcap": b"\x89MCAP0\r\n\x01\x00"}),
    Mistake("run of a run's folder", "run runs", "runs:1:1: is a folder", "name a file in it: runs/config.yaml",
        files={"runs/config.yaml": PLATOON, "runs/run.mcap": b"\x89MCAP0\r\n"}),
    Mistake("a driver of no robot", "node driver platoon.yaml --robots r9", "--robots: there is no robot 'r9'",
        "it has r1, r2, r3, r4"),
    Mistake("a driver of nobody", "node driver platoon.yaml", "--robots: is missing",
        "robofleet node driver lab.yaml --robots r1,r2"),
    Mistake("an experiment misspelt", "paper lane-chang", "there is no experiment 'lane-chang'",
        "did you mean 'lane-change'?"),
    Mistake("a storm of no seeds", "storm platoon.yaml --seeds 0", "--seeds: ", "must be greater than or equal to 1"),
    # YAML
    edited("a tab", "", "indent with spaces", "  - {id: r1,", "«\t- {id: r1,"),
    Mistake("no colon", "check platoon.yaml", "platoon.yaml:", "this key has no colon: write `key: value`",
        ("    spacing_m: 0.25", "    spacing_m 0.25")),
    Mistake("no space after a colon", "check platoon.yaml", "platoon.yaml:",
        "no space follows the colon: write `key: value`", ("  tick_s: 0.033", "  tick_s:0.033")),
    Mistake("an indentation too deep", "check platoon.yaml", "platoon.yaml:", "indent the keys of one mapping alike",
        ("    spacing_m: 0.25", "      spacing_m: 0.25")),
    Mistake("an indentation too shallow", "check platoon.yaml", "platoon.yaml:", "indent",
        ("    spacing_m: 0.25", "   spacing_m: 0.25")),
    Mistake("a bracket left open", "check platoon.yaml", "platoon.yaml:", "write ] at its end",
        ("[r1, r2, r3, r4]", "[r1, r2, r3, r4")),
    edited("a key written twice", "groups.0.settings.spacing_m: is written twice", "remove one",
        "      path_rate: 0.0455", "      path_rate: 0.0455\n      «spacing_m: 0.3"),
    Mistake("an empty file", "check empty.yaml", "empty.yaml:1:1: is empty", "copy configs/platoon.yaml",
        files={"empty.yaml": ""}),
    Mistake("a file that is no text", "check latin.yaml", "latin.yaml:1:14: ", "save the file as UTF-8",
        files={"latin.yaml": "arena: {name: \xe4}".encode("latin-1")[0:13] + b"\xe4}"}),
    Mistake("a list for a mapping", "check list.yaml", "list.yaml:1:1: ", "must be a mapping",
        files={"list.yaml": "- arena\n"}),
    Mistake("robots as a mapping", "check platoon.yaml --set robots={a:1}", "--set robots={{a:1}}: robots: ",
        "must be a list"),
    # keys and values
    edited("an unknown key", "groups.0.settings.path_rat: ", "did you mean 'path_rate'?", "path_rate: 0.0455",
        "«path_rat: 0.0455"),
    edited("a key without its unit", "groups.0.settings.spacing: ", "did you mean 'spacing_m'?", "spacing_m: 0.25",
        "«spacing: 0.25"),
    edited("a decimal comma", "groups.0.settings.spacing_m: ", "write 0.25", "spacing_m: 0.25", "spacing_m: «0,25"),
    edited("a unit behind a number", "groups.0.settings.spacing_m: ", "write 0.25", "spacing_m: 0.25",
        "spacing_m: «0.25 m"),
    edited("a number in quotes", "controller.alpha: ", "remove the quotes", "alpha: 45", "alpha: «'45'"),
    edited("yes for true", "run.attended: ", "write true or false", "duration_s: 88,",
        "duration_s: 88, attended: «yes,"),
    edited("an exponent that YAML reads as text", "controller.alpha: ", "write 4.5e+1", "alpha: 45", "alpha: «4.5e1"),
    edited("a size in centimetres", "groups.0.settings.spacing_m: ", "in cm or mm?", "spacing_m: 0.25",
        "spacing_m: «25"),
    edited("an arena in millimetres", "arena.size_m.0: ", "in cm or mm?", "size_m: [3.2, 2.0]", "size_m: [«3200, 2.0]"),
    edited("a tag's side in millimetres", "tracker.tag_side_m: ", "in cm or mm?", "tag_side_m: 0.07",
        "tag_side_m: «70"),
    Mistake("a wheel in millimetres", "check platoon.yaml --set robots.0.vehicle.wheel_radius_m=16",
        "--set robots.0.vehicle.wheel_radius_m=16: robots.0.vehicle.wheel_radius_m: ", "is 16 in mm?"),
    edited("a tick in milliseconds", "controller.tick_s: ", "is 33 in ms?", "tick_s: 0.033", "tick_s: «33"),
    edited("a heading beyond a turn", "robots.0.start.heading_deg: ", "must be at most 360", "heading_deg: 53.0",
        "heading_deg: «530"),
    Mistake("degrees for radians", "check platoon.yaml --set tracker.truth.heading_noise_rad=25",
        "--set tracker.truth.heading_noise_rad=25: tracker.truth.heading_noise_rad: ", "is 25 in degrees?"),
    edited("a tick of nothing", "controller.tick_s: ", "must be at least 0.001", "tick_s: 0.033", "tick_s: «0"),
    edited("no number", "controller.alpha: ", "must be a finite number", "alpha: 45", "alpha: «.nan"),
    edited("a behaviour misspelt", "groups.0.behaviour: ", "did you mean 'platoon'?", "behaviour: platoon",
        "behaviour: «plattoon"),
    Mistake("a part that is missing", "check platoon.yaml", "platoon.yaml:2:1: tracker: is missing",
        "configs/README.md",
        (TRACKER, "")),
    # files that it names
    edited("no such vehicle", "robots.0.vehicle: there is no file", "did you mean 'gternal'?",
        "{id: r1, tag: 1, vehicle: gternal,", "{id: r1, tag: 1, vehicle: «gternel,"),
    edited("no such path", "groups.0.settings.path: there is no file", "did you mean 'platoon'?", "path: platoon",
        "path: «platon"),
    edited("a path by its folder", "groups.0.settings.path: ", "write platoon", "path: platoon",
        "path: «paths/platoon"),
    edited("a path's file that is not there", "groups.0.settings.path: there is no file paths/eigt.yaml",
        "did you mean paths/eight.yaml?", "path: platoon", "path: «paths/eigt.yaml",
        files={"paths/eight.yaml": "knots: []\n"}),
    # robots
    edited("an id twice", "robots.1.id: r1 is robots.0's already", "give each robot its own", "{id: r2,", "{id: «r1,"),
    edited("a tag twice", "robots.2.tag: 1 is robots.0's already", "give each robot its own", "tag: 3", "tag: «1"),
    edited("an id in capitals", "robots.0.id: ", "must be a small letter", "{id: r1,", "{id: «R1,"),
    edited("a group of no such robot", "groups.0.robots.2: there is no robot 'r7'", "known: r1, r2, r3, r4",
        "[r1, r2, r3, r4]", "[r1, r2, «r7, r4]"),
    edited("a robot twice in a group", "groups.0.robots.2: r2 is in the group already", "remove one",
        "[r1, r2, r3, r4]", "[r1, r2, «r2, r3, r4]"),
    edited("two robots in the wrong order",
        "groups.0.robots: r1 stands ahead of r2, and the group's order is r4, r3, r2, r1",
        "write `robots: [r1, r2, r3, r4]`", "[r1, r2, r3, r4]", "«[r4, r3, r2, r1]"),
    edited("a robot in no group without a place", "robots.4.start: is missing", "write start: {x_m:", "groups:",
        "  - «{id: r5, tag: 5, vehicle: gternal}\ngroups:"),
    edited("no such driver", "robots.0.driver: ", "did you mean 'gternal'?", "{id: r1, tag: 1,",
        "{id: r1, tag: 1, driver: «gtrnal,"),
    edited("a port forgotten", "robots.0.settings.port: is missing", "add it", "{id: r1, tag: 1,",
        "«{id: r1, tag: 1, driver: gternal,", alone=False),
    Mistake("a port that is not there", "check lab1.yaml", "lab1.yaml:{at}: robots.0.settings.port: ",
        "/dev/robofleet-nowhere", ("{port: /dev/robofleet/r1}", "{port: «/dev/robofleet-nowhere}"), base=LAB,
        alone=False),
    edited("a baud rate for a robot that takes none", "robots.0.settings: ", "remove them", "{id: r1, tag: 1,",
        "{id: r1, tag: 1, settings: «{baud: 9600},"),
    Mistake("a calibration of another robot", "check platoon.yaml", "cal.yaml:1:1: was measured on 'r2', not on 'r1'",
        "calibrate this robot", ("{id: r1, tag: 1,", "{id: r1, tag: 1, calibration: «cal.yaml,"),
        files={"cal.yaml": "robot: r2\n"}),
    Mistake("a real robot in lockstep", "run lab.yaml --lockstep", "lab.yaml:29:13: robots.0.driver: ",
        "run without --lockstep", files={"lab.yaml": LAB}, alone=False),
    # the laboratory
    Mistake("a path that leaves the arena", "check platoon.yaml", f"{ROOT}/robofleet/configs/paths/platoon.yaml:4:1: ",
        "move its knots inwards", ("size_m: [3.2, 2.0]", "size_m: [3.2, 1.8]")),
    edited("a spacing too small", "groups.0.settings.spacing_m: ", "raise it", "spacing_m: 0.25", "spacing_m: «0.2"),
    edited("a path rate too fast", "groups.0.settings.path_rate: ", "fits", "path_rate: 0.0455", "path_rate: «0.075"),
    edited("a start outside the arena", "robots.0.start: ", "move r1 into the arena",
        "start: {x_m: -1.212, y_m: 0.500,", "start: «{x_m: -1.212, y_m: 0.980,"),
    edited("two robots in one place", "robots.1.start: ", "move r1 and r2 apart", "start: {x_m: -1.382, y_m: 0.254,",
        "start: «{x_m: -1.212, y_m: 0.500,"),
    Mistake("no camera", "check cam.yaml", "cam.yaml:{at}: camera.v4l2.device: there is no camera", "/dev/video97",
        ("{device: /dev/video0}", "{device: «/dev/video97}"), base=LAB, alone=False),
    edited("no such camera", "camera.source: ", "did you mean 'v4l2'?", "camera: {model: overhead,",
        "camera: {source: «v4l, model: overhead,"),
    edited("a size that was not calibrated", "camera.width: ", "calibrate again", "width: 1280", "width: «1920"),
]
# fmt: on


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the user's folder, with a ``platoon.yaml`` in it."""
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "TMPDIR"):
        monkeypatch.setenv(name, str(tmp_path_factory.mktemp(name)))
    (tmp_path / "platoon.yaml").write_text(PLATOON)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def prepared(folder: Path, mistake: Mistake) -> str:
    """Write the files of a mistake; return line and column of « in its edit."""
    for name, content in mistake.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    if mistake.edit is None:
        return ""
    old, new = mistake.edit
    assert mistake.base.count(old) == 1
    text = mistake.base.replace(old, new)
    before, _, _ = text.partition("«")
    name = next(word for word in mistake.typed.split() if word.endswith(".yaml"))
    (folder / name).write_text(text.replace("«", ""))
    return f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"


def content_of(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_a_mistake_is_one_line_with_its_place_and_its_cure(
    folder: Path, mistake: Mistake, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    at = prepared(folder, mistake)
    before = content_of(folder)
    monkeypatch.setattr(run_command, "_result", lambda *a, **k: pytest.fail("it was started"))
    monkeypatch.setattr(sys, "argv", ["robofleet", *mistake.typed.split()])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capfd.readouterr()
    print(f"{mistake.name} | {captured.err}")
    assert ended.value.code == 2, captured
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith(mistake.where.format(at=at))]
    assert len(lines) == 1
    assert mistake.cure in lines[0]
    assert captured.err.splitlines() == lines or not mistake.alone
    assert content_of(folder) == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a name misspelt", "an option misspelt", "a tab", "hold with nothing running"])
def test_a_process_says_the_same(folder: Path, name: str) -> None:
    mistake = next(mistake for mistake in MISTAKES if mistake.name == name)
    at = prepared(folder, mistake)
    done = subprocess.run(
        [sys.executable, "-m", "robofleet", *mistake.typed.split()], capture_output=True, text=True, check=False
    )
    (line,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (2, "")
    assert line.startswith(mistake.where.format(at=at))
    assert mistake.cure in line


def test_these_are_fifty_mistakes_and_more() -> None:
    assert len({mistake.name for mistake in MISTAKES}) == len(MISTAKES) >= 50
