"""What a run says to a person: the summary beside the paper's figures."""

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

Summary = dict[str, Any]

PAPER_CONTROL_ERROR_MM = 5.0  # IV-C: mean of the four robots after 1.4 s, on hardware
PAPER_SPACING_M = 0.25  # IV-C: d
_SHOWN = 4  # stops


def summary_table(summary: Summary) -> Table:
    """Return the table that ends a run."""
    cause = f" ({summary['cause']})" if summary["cause"] else ""
    table = Table(
        title=Text(f"{summary['config']}: {summary['outcome']}{cause}", "bold"),
        title_justify="left",
        caption=Text(_caption(summary)),
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("\nfigure", no_wrap=True)
    table.add_column(f"this run\n({_mode(summary)})", justify="right")
    table.add_column("the paper\n(hardware)", justify="right")
    table.add_column("each robot\n" + " ".join(f"{robot:>5}" for robot in summary["robots"]))
    for row in (*_errors(summary), *_health(summary)):
        table.add_row(*map(Text, row))  # no text of a run is markup
    return table


def _mode(s: Summary) -> str:
    """Return whether what was measured exists: the truth is known of simulated robots alone."""
    return "simulation" if not s["estimated"] else "real" if len(s["estimated"]) == len(s["robots"]) else "mixed"


def _caption(s: Summary) -> str:
    control = "the control error is of x + T u, of x + T (u + w) with a disturbance w"
    if not s["estimated"]:
        return f"errors and deviations: mean (max), on the true poses; times: p50, p99\n{control}"
    estimated = f"estimated: no truth is known of {', '.join(s['estimated'])}"
    return f"errors and deviations: mean (max); times: p50, p99\n{control}\n{estimated}"


def _errors(s: Summary) -> list[tuple[str, str, str, str]]:
    rows = []
    for name, label, paper in (
        ("control_error_mm", "control error, mm", f"about {PAPER_CONTROL_ERROR_MM:g}"),
        ("timed_error_mm", "timed error, mm", "-"),
        ("path_error_mm", "point off the path, mm", "-"),
        ("centre_error_mm", "centre off the path, mm", "-"),
    ):
        figure = s[name]
        if figure is None:
            rows.append((label, "not measured", paper, ""))
        else:
            each = " ".join("    -" if value is None else f"{value:5.2f}" for value in figure["per_robot_mean"])
            rows.append((label, f"{figure['mean']:.2f} ({figure['max']:.1f})", paper, each))
    spacing = s["spacing_m"]
    if spacing is not None:
        each = " " * 6 + " ".join("    -" if value is None else f"{value * 1e3:5.1f}" for value in spacing["mean"])
        known = [value for value in spacing["mean"] if value is not None]
        mean = f"{1e3 * sum(known) / len(known):.1f}"
        rows.append(("spacing, mm", mean, f"target {PAPER_SPACING_M * 1e3:g}", each))
        rows.append(("spacing's deviation, mm", f"({spacing['max_deviation_mm']:.1f})", "-", ""))
    return rows


def _health(s: Summary) -> list[tuple[str, str, str, str]]:
    rows = []
    if s["min_gap_mm"] is not None:
        rows.append(("smallest body gap, mm", f"{s['min_gap_mm']:.0f}", "-", ""))
    if s["pose_error"] is not None:
        p = s["pose_error"]
        rows.append(("pose, rms, mm and deg", f"{p['rms_mm']:.2f}, {p['heading_rms_deg']:.2f}", "-", ""))
    tracker, tick = s["tracker"], s["tick"]
    if tracker["frames"]:
        note = f"{tracker['frames']} images, {tracker['frame_ms']['p50']:.1f} ms each"
        rows.append(("tags found, %", f"{100 * tracker['measured_fraction']:.1f}", "-", note))
    if tick["compute_us"] is not None:
        value = f"{tick['compute_us']['p50']:.0f}, {tick['compute_us']['p99']:.0f}"
        rows.append(("computing a tick, us", value, "-", f"of {tick['period_ms'] * 1e3:g}"))
    if tick["overruns"] is not None:
        rows.append(("overruns", str(tick["overruns"]), "-", f"of {s['ticks']} ticks"))
    if s["latency_ms"] is not None:
        latency = s["latency_ms"]["exposure_to_wheel"]
        rows.append(("exposure to wheel, ms", f"{latency['p50']:.1f}, {latency['p99']:.1f}", "-", ""))
    if s["stops"]:
        stops = "\n".join(map(_stop, s["stops"][:_SHOWN]))
        rows.append(("robots stopped on the way", str(len(s["stops"])), "-", stops))
    return rows


def _stop(stop: dict[str, Any]) -> str:
    took = "" if stop["output_ms"] is None else f" (still after {stop['output_ms']:.0f} ms)"
    return f"{stop['robot']} at {stop['t_s']:.1f} s: {stop['cause']}{took}"


def status_table(status: dict[str, Any]) -> Table:
    """Return what a running arena says of itself: ``processes.operator.status``."""
    phase, cause = status["phase"] or "the supervisor is silent", status["cause"]
    table = Table(
        title=Text(f"{status['arena']}: {phase}" + (f" ({cause})" if cause else ""), "bold"),
        title_justify="left",
        caption=Text(f"{status['folder']}, since {status['started']}, process {status['pid']}"),
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    for column in ("robot", "gate", "latch", "battery", "heard", "halted"):
        table.add_column(column)
    for robot in status["robots"]:
        if robot["gate"] is None:
            table.add_row(robot["id"], Text("silent", "bold red"), "", "", "", Text(robot["halted"] or ""))
            continue
        battery = "unknown" if robot["battery"] is None else f"{100 * robot['battery']:.0f} %"
        gate = Text(robot["gate"], "green" if robot["gate"] == "open" else "yellow")
        latch = Text(robot["latch"], "" if robot["latch"] == "none" else "bold red")
        table.add_row(robot["id"], gate, latch, battery, f"{robot['age_ms']:.0f} ms ago", Text(robot["halted"] or ""))
    return table
