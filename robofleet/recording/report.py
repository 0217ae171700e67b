"""What a run says to a person: the summary beside the paper's figures."""

from typing import Any

from rich.table import Table

Summary = dict[str, Any]

PAPER_CONTROL_ERROR_MM = 5.0  # IV-C: mean of the four robots after 1.4 s, on hardware
PAPER_SPACING_M = 0.25  # IV-C: d


def summary_table(summary: Summary) -> Table:
    """Return the table that ends a run."""
    title = f"{summary['config']}: {summary['outcome']}" + (f" ({summary['cause']})" if summary["cause"] else "")
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("figure")
    table.add_column("this run\n(simulation)", justify="right")
    table.add_column("the paper\n(hardware)", justify="right")
    table.add_column("per robot " + " ".join(summary["robots"]))
    for row in (*_errors(summary), *_health(summary)):
        table.add_row(*row)
    return table


def _errors(s: Summary) -> list[tuple[str, str, str, str]]:
    rows = []
    for name, label, paper in (
        ("control_error_mm", "control error, mean [mm]", f"about {PAPER_CONTROL_ERROR_MM:g}"),
        ("timed_error_mm", "timed error, mean [mm]", "-"),
        ("path_error_mm", "distance of the point from the path, mean [mm]", "-"),
        ("centre_error_mm", "distance of the centre from the path, mean [mm]", "-"),
    ):
        figure = s[name]
        if figure is None:
            rows.append((label, "not measured", paper, ""))
        else:
            each = " ".join(f"{value:.2f}" for value in figure["per_robot_mean"])
            rows.append((label, f"{figure['mean']:.2f} (max {figure['max']:.1f})", paper, each))
    spacing = s["spacing_m"]
    if spacing is not None:
        mean = " ".join(f"{value * 1e3:.1f}" for value in spacing["mean"])
        deviation = f"{spacing['max_deviation_mm']:.1f}"
        rows.append(("spacing, largest deviation [mm]", deviation, "not given", f"mean {mean}"))
    return rows


def _health(s: Summary) -> list[tuple[str, str, str, str]]:
    rows = []
    if s["min_gap_mm"] is not None:
        rows.append(("smallest gap between two bodies [mm]", f"{s['min_gap_mm']:.0f}", "-", ""))
    if s["pose_error"] is not None:
        p = s["pose_error"]
        value = f"{p['rms_mm']:.2f} mm, {p['heading_rms_deg']:.2f}°"
        rows.append(("pose error of the filter, rms", value, "-", ""))
    tracker, tick = s["tracker"], s["tick"]
    if tracker["frames"]:
        value = f"{100 * tracker['measured_fraction']:.1f} %"
        work = tracker["frame_ms"]
        note = f"{tracker['frames']} images, {work['p50']:.1f} ms each (p99 {work['p99']:.1f})"
        rows.append(("tags found", value, "-", note))
    if tick["compute_us"] is not None:
        value = f"{tick['compute_us']['p50']:.0f} / {tick['compute_us']['p99']:.0f}"
        rows.append(("tick's computing, p50 / p99 [us]", value, "-", f"of {tick['period_ms']:g} ms"))
        rows.append(("overruns", str(tick["overruns"]), "-", f"in {s['ticks']} ticks"))
    if s["latency_ms"] is not None:
        latency = s["latency_ms"]["exposure_to_wheel"]
        rows.append(("exposure to wheel, p50 / p99 [ms]", f"{latency['p50']:.1f} / {latency['p99']:.1f}", "-", ""))
    if s["stops"]:
        stops = "; ".join(f"{stop['robot']} at {stop['t_s']:.1f} s: {stop['cause']}" for stop in s["stops"][:4])
        rows.append(("gates closed during the run", str(len(s["stops"])), "-", stops))
    return rows
