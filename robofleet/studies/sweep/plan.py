"""What a sweep's file says, and which runs that makes: every one with its number, before any is run."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, JsonValue

from robofleet.config.files.parameters import Parameters
from robofleet.config.slices import generator
from robofleet.core.settings import MANY, Model, Name, Named, within

_DRAWN_DIGITS = 6  # of a drawn number: it can be read, and typed again
_MOST_RUNS = 1_000_000

Key = Annotated[str, Field(min_length=1, max_length=4096)]
Bound = Annotated[float, within(-1e12, 1e12)]
Bounds = Annotated[tuple[Bound, Bound], Field(strict=False)]
Whole = Annotated[int, within(-(10**12), 10**12)]
Wholes = Annotated[tuple[Whole, Whole], Field(strict=False)]
Values = Annotated[tuple[JsonValue, ...], Field(min_length=1, max_length=MANY, strict=False)]
Seed = Annotated[int, within(0, 2**63 - 1)]
Mode = Literal["lockstep", "real_time", "environment"]
CASE = "case"  # the column of a sweep's cases


class Distribution(Model):
    """How a key's value is drawn: one of these."""

    uniform: Bounds | None = None
    """Between two numbers."""
    log_uniform: Bounds | None = None
    """Between two positive numbers; their logarithms are drawn uniformly."""
    integers: Wholes | None = None
    """A whole number between two, both included."""
    choice: Values | None = None
    """One of these values."""

    @property
    def span(self) -> tuple[float, float] | None:
        """Between which numbers it draws; None: one of a choice."""
        return self.uniform or self.log_uniform or self.integers

    def complaint(self) -> str | None:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            return "say one of uniform, log_uniform, integers, choice, as {uniform: [0.2, 0.4]}"
        if self.span is not None and not self.span[0] < self.span[1]:
            return f"{given[0]} must rise: write [{self.span[1]:g}, {self.span[0]:g}]"
        if self.log_uniform is not None and self.log_uniform[0] <= 0:
            return "log_uniform needs positive numbers: make the first greater than 0"
        return None

    def draw(self, seed: int, key: str, count: int) -> list[Any]:
        """Return so many values; each key has randomness of its own, so another key changes none of them."""
        rng = generator(seed, "sweep", key)
        if self.choice is not None:
            return [self.choice[i] for i in rng.integers(len(self.choice), size=count)]
        if self.integers is not None:
            return [int(value) for value in rng.integers(*self.integers, size=count, endpoint=True)]
        if self.log_uniform is not None:
            low, high = self.log_uniform
            drawn = [math.exp(value) for value in rng.uniform(math.log(low), math.log(high), size=count)]
        else:
            assert self.uniform is not None
            low, high = self.uniform
            drawn = rng.uniform(low, high, size=count).tolist()
        return [min(max(float(f"{value:.{_DRAWN_DIGITS}g}"), low), high) for value in drawn]


class Random(Model):
    """Keys whose values are drawn together."""

    count: Annotated[int, within(1, _MOST_RUNS)]
    """How many draws."""
    seed: Seed = 1
    """Seed of the draws. The same seed draws the same values."""
    keys: Annotated[dict[Key, Distribution], Field(min_length=1, max_length=MANY)]
    """Each key's distribution."""


class Seeds(Model):
    """Seeds one after the other."""

    first: Seed = 1
    """The first seed."""
    count: Annotated[int, within(1, _MOST_RUNS)]
    """How many."""


class Case(Model):
    """Keys that change together, and where the runs take place."""

    set: dict[Key, JsonValue] = Field(default_factory=dict)
    """Keys that the case changes."""
    mode: Mode = "lockstep"
    """``lockstep``: simulated on a simulated clock. ``real_time``: simulated by processes, over Zenoh, one run at a
    time. ``environment``: the arenas in which policies are trained, for groups with the behaviour ``policy``."""


class Sweep(Parameters):
    """A sweep's file."""

    config: Named
    """The configuration; a path from this file's folder."""
    set: dict[Key, JsonValue] = Field(default_factory=dict)
    """Keys that every run changes."""
    cases: Annotated[dict[Name, Case], Field(max_length=MANY)] = Field(default_factory=dict)
    """Cases by their names: every one is run with every combination of the grid."""
    grid: dict[Key, Values] = Field(default_factory=dict)
    """Keys and their values: every combination is run."""
    random: Random | None = None
    """Keys whose values are drawn; every draw is run with every combination of the grid."""
    seeds: Seeds | None = None
    """Seeds (run.seed) of every setting; null: the configuration's."""
    faults: Annotated[tuple[Named | None, ...], Field(min_length=1, max_length=MANY, strict=False)] = (None,)
    """Files of faults, paths from this file's folder; null among them is a run without."""
    runs: Annotated[int, within(1, _MOST_RUNS)] = 1000
    """How many runs may come of it, at most."""

    @property
    def keys(self) -> tuple[str, ...]:
        return (*((CASE,) if self.cases else ()), *self.grid, *(self.random.keys if self.random else ()))

    @property
    def every_seed(self) -> Sequence[int | None]:
        return (None,) if self.seeds is None else range(self.seeds.first, self.seeds.first + self.seeds.count)

    @property
    def factors(self) -> dict[str, int]:
        return {
            "cases": max(1, len(self.cases)),
            "combinations of the grid": math.prod(len(values) for values in self.grid.values()),
            "draws": self.random.count if self.random else 1,
            "files of faults": len(self.faults),
            "seeds": len(self.every_seed),
        }

    @property
    def total(self) -> int:
        return math.prod(self.factors.values())


class Setting(NamedTuple):
    """What one run, or several with seeds of their own, has for the keys that vary, and for faults."""

    case: str | None
    values: dict[str, Any]  # of the keys that the configuration knows
    paths: dict[str, tuple[str | int, ...]]  # where in the sweep's file each value, or its distribution, stands
    faults: int  # of Sweep.faults

    @property
    def columns(self) -> dict[str, Any]:
        """What the run has in the columns of ``Sweep.keys``."""
        return self.values if self.case is None else {CASE: self.case, **self.values}


def settings(sweep: Sweep) -> Iterator[Setting]:
    """Yield every setting, in the order of the runs: cases, the grid (its last key fastest), draws, then faults."""
    draws: dict[str, list[Any]] = {}
    drawn_at: dict[str, tuple[str | int, ...]] = {}
    count = 1
    if sweep.random is not None:
        count = sweep.random.count
        for key, distribution in sweep.random.keys.items():
            draws[key] = distribution.draw(sweep.random.seed, key, count)
            drawn_at[key] = ("random", "keys", key)
    every_case: list[str | None] = [*sweep.cases] or [None]
    combinations = itertools.product(*(range(len(values)) for values in sweep.grid.values()))
    for case, chosen in itertools.product(every_case, combinations):
        own = {} if case is None else sweep.cases[case].set
        own_at: dict[str, tuple[str | int, ...]] = {key: ("cases", str(case), "set", key) for key in own}
        rows = dict(zip(sweep.grid, chosen, strict=True))
        grid = {key: sweep.grid[key][i] for key, i in rows.items()}
        grid_at: dict[str, tuple[str | int, ...]] = {key: ("grid", key, i) for key, i in rows.items()}
        for draw in range(count):
            drawn = {key: values[draw] for key, values in draws.items()}
            for faults in range(len(sweep.faults)):
                yield Setting(case, own | grid | drawn, own_at | grid_at | drawn_at, faults)
