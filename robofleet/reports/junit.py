"""A run as a CI reads it: JUnit XML with a test case for the run and one for each of its bounds.

Valid against the schema of Ant's JUnit task, which other readers' schemas contain. That schema has no place for a
figure in a case that passed: properties and ``system-out`` of the suite have the value and the limit of each bound.
"""

import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from robofleet.core.clock import utc_now
from robofleet.core.files import write_text
from robofleet.reports.bounds import JUDGED, is_judged, limit, shown

Summary = dict[str, Any]

_COUNTED = {"failures": "failure", "errors": "error", "skipped": "skipped"}
_NO_XML = {code: "\N{REPLACEMENT CHARACTER}" for code in (*range(32), 0x7F, 0xFFFE, 0xFFFF) if chr(code) not in "\t\n"}


def write(summary: Summary, lost: list[str], file: Path) -> None:
    """Write a run's summary, and what of its results was lost; OSError if the file cannot be written."""
    suites = Element("testsuites")
    suite = SubElement(suites, "testsuite", _suite(summary))
    properties = SubElement(suite, "properties")
    for name, value in _properties(summary):
        SubElement(properties, "property", name=name, value=_text(value))
    cases = [_run(summary, lost), *(_bound(summary, bound) for bound in summary["bounds"])]
    for case in cases:
        case.set("classname", _text(summary["config"]))
    suite.extend(cases)
    suite.set("tests", str(len(cases)))
    for attribute, verdict in _COUNTED.items():
        suite.set(attribute, str(len([*suite.iter(verdict)])))
    SubElement(suite, "system-out").text = _text("\n".join(_output_lines(summary)))
    SubElement(suite, "system-err").text = _text("\n".join(lost))
    indent(suites)
    write_text(file, '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(suites, encoding="unicode") + "\n")


def _suite(summary: Summary) -> dict[str, str]:
    began = summary["began"] or f"{utc_now():%Y-%m-%dT%H:%M:%SZ}"
    return {
        "id": "0",
        "package": "robofleet",
        "name": _text(summary["config"]) or "run",
        "hostname": platform.node() or "localhost",
        "timestamp": began.removesuffix("Z"),
        "time": f"{summary['duration_s']:.3f}",
    }


def _properties(summary: Summary) -> Iterator[tuple[str, object]]:
    for name in ("outcome", "cause", "mode", "seed", "ticks", "duration_s", "trace_hash"):
        if summary[name] is not None:
            yield name, summary[name]
    for bound in summary["bounds"]:
        yield bound["figure"], "not measured" if bound["value"] is None else bound["value"]
        yield f"run.bounds.{bound['figure']}", bound["limit"]


def _run(summary: Summary, lost: list[str]) -> Element:
    """Return the case that the run came to its end, and kept its results."""
    outcome, cause, took_s = summary["outcome"], summary["cause"] or "", summary["duration_s"]
    if outcome == "stopped":  # by the operator: no error
        return _case("completed", took_s, "failure", outcome, cause)
    if outcome != "completed":
        return _case("completed", took_s, "error", outcome, cause or "how the run ended was not recorded")
    return _case("completed", took_s, "error", "results lost", "\n".join(lost)) if lost else _case("completed", took_s)


def _bound(summary: Summary, bound: dict[str, Any]) -> Element:
    name = f"{JUDGED[bound['figure']].label}: {limit(bound)}"
    if bound["pass"]:
        return _case(name, 0.0)
    if not is_judged(summary, bound):
        return _case(name, 0.0, "skipped", why="not measured: the run ended too early")
    return _case(name, 0.0, "failure", f"run.bounds.{bound['figure']}", shown(bound))


def _case(name: str, seconds: float, verdict: str | None = None, kind: str = "", why: str = "") -> Element:
    """Return a test case; ``verdict``: failure, error or skipped, None where it passed."""
    case = Element("testcase", name=_text(name), time=f"{seconds:.3f}")
    if verdict is not None:
        reason = SubElement(case, verdict, message=_text(why))
        reason.text = _text(why)
        if kind:  # the schema has no kind of what was skipped
            reason.set("type", kind)
    return case


def _output_lines(summary: Summary) -> Iterator[str]:
    yield f"{summary['config']}: {summary['outcome']}" + (f": {summary['cause']}" if summary["cause"] else "")
    for bound in summary["bounds"]:
        verdict = "met" if bound["pass"] else "not met" if is_judged(summary, bound) else "not checked"
        yield f"{JUDGED[bound['figure']].label}: {shown(bound)}: {verdict}"


def _text(value: object) -> str:
    """Return something as text that XML can carry."""
    return str(value).encode(errors="backslashreplace").decode().translate(_NO_XML)
