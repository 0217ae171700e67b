"""What the operator sees of a storm: what broke, and the command that shows it again."""

import sys
from collections.abc import Iterator

from rich.console import Console
from rich.table import Table

from robofleet.config.faults import counted
from robofleet.core.sentences import wrapped
from robofleet.safety.supervisor import Event
from robofleet.studies.storm.episode import Episode
from robofleet.studies.storm.schedule import KINDS
from robofleet.studies.storm.tally import REACTIONS, Tally

_SHOWN_VIOLATIONS = 5  # of one seed


def lines(episode: Episode, replay: str) -> Iterator[str]:
    """``replay``: the command, but for its seed."""
    if not episode.violations:
        return
    yield f"seed {episode.seed}: {replay} --seeds 1 --first {episode.seed}"
    for violation in episode.violations[:_SHOWN_VIOLATIONS]:
        yield f"  {violation}"
    if len(episode.violations) > _SHOWN_VIOLATIONS:
        yield f"  and {len(episode.violations) - _SHOWN_VIOLATIONS} more"
    yield f"  the fleet ran first at {episode.run_s:.3f} s; from then on:"
    for fault in episode.plan.faults:
        fields = fault.model_dump(exclude_none=True, exclude={"kind", "at_s", "duration_s"})
        yield f"  {fault.at_s:8.3f} s, for {fault.duration_s:.3f} s: {fault.kind} {fields}"
    for act in episode.plan.acts:
        yield f"  {act.at_s:8.3f} s: the operator asks for {act.request!r}"


def summarise(tally: Tally, elapsed_s: float) -> bool:
    table = Table("fault", "times", "effects", "reaction", "seeds", title="what came, and what was done about it")
    events = sorted(event for event in Event if event and (tally.events[event] or event in REACTIONS))
    for row in range(max(len(KINDS), len(events))):
        kind = KINDS[row] if row < len(KINDS) else ""
        event = events[row] if row < len(events) else None
        fault = (kind, str(tally.scheduled[kind]), str(tally.injected[kind])) if kind else ("", "", "")
        table.add_row(*fault, *((event.name.lower(), str(tally.events[event])) if event else ("", "")))
    Console().print(table)
    ending = (
        f"{len(tally.failed)} of {counted(tally.seeds, 'run')} failed. {tally.simulated_s:.0f} s were simulated in "
        f"{elapsed_s:.0f} s ({tally.simulated_s / elapsed_s:.0f} times real time). Longest queue of steps: "
        f"{tally.longest_queue}. Runs after which robots stood too close to start again: {tally.crowded}."
    )
    print(wrapped(ending, sys.stdout))
    shortfalls = list(tally.shortfalls())
    for shortfall in shortfalls:
        print(f"the storm proves too little: {shortfall}", file=sys.stderr)
    for unplayed in tally.unplayed:
        print(unplayed, file=sys.stderr)
    return not tally.failed and not shortfalls and not tally.unplayed
