"""A storm finds what is wrong with a gate or with a supervisor, and nothing where nothing is."""

import math
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import pytest

from robofleet.config.tree import Config
from robofleet.processes.storm import workers
from robofleet.processes.storm.episode import play
from robofleet.processes.storm.schedule import KINDS, WINDOW_S, plan
from robofleet.processes.storm.tally import Tally


@pytest.fixture(scope="module")
def fleet(platoon_of: Callable[..., Config]) -> Config:
    return platoon_of("tracker.source=truth")


def test_the_same_seed_plans_the_same_storm_and_another_seed_another_one(fleet: Config) -> None:
    assert plan(fleet, 7) == plan(fleet, 7)
    assert plan(fleet, 7) != plan(fleet, 8)


def test_every_fault_heals_by_the_time_that_the_plan_names_and_every_kind_comes(fleet: Config) -> None:
    plans = [plan(fleet, seed) for seed in range(1, 201)]
    for storm in plans:
        ends = [fault.at_s + fault.duration_s for fault in storm.faults]
        assert max(ends) <= storm.healed_s <= WINDOW_S
    assert {fault.kind for storm in plans for fault in storm.faults} == set(KINDS)
    assert any(_overlap(storm.faults) for storm in plans)
    assert any(math.isinf(storm.outside_s) for storm in plans)
    assert any(not math.isinf(storm.outside_s) for storm in plans)


def _overlap(faults: Iterable[Any]) -> bool:
    times = sorted((fault.at_s, fault.at_s + fault.duration_s) for fault in faults)
    return any(later[0] < earlier[1] for earlier, later in pairwise(times))


def test_twenty_storms_leave_every_invariant_standing(fleet: Config) -> None:
    tally = workers.storm(fleet, range(1, 21), lambda _tally, _episode: None)
    assert [(e.seed, *e.violations[:2]) for e in tally.failed] == []
    assert list(tally.shortfalls()) == []
    assert tally.seeds == 20


def test_a_storm_that_never_brought_what_it_planned_proves_too_little(fleet: Config) -> None:
    tally = Tally()
    done = play(fleet, 1)
    tally.add(done)
    assert list(tally.shortfalls()) == []
    tally.injected.clear()
    kinds = {fault.kind for fault in done.plan.faults}
    assert {line.split()[0] for line in tally.shortfalls()} == kinds
