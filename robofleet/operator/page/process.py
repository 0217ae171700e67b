"""The page's process: one of a run, or one that somebody starts by hand beside it."""

import asyncio
import os
import socket
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

from rich.console import Console

from robofleet.bus.joining import joined
from robofleet.bus.permissions import PAGE
from robofleet.config.projectors import ProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.core.refusal import RefusedError
from robofleet.nodes.node import Lifeline
from robofleet.operator.page.browser import open_page
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.command import Over, There, how_ended
from robofleet.operator.page.ending import STAYS_MIN
from robofleet.operator.page.known_page import forget, keep
from robofleet.operator.page.page_address import Addresses, address_lines, projector_address
from robofleet.operator.page.server import Served, serve
from robofleet.operator.terminal.qr_code import qr_code
from robofleet.projection.display import DisplayError
from robofleet.projection.kiosk import kiosk
from robofleet.runs.companion import STAYS

_LOOK_NS = S // 4
_NICE = 5  # the page waits for the run, never the other way round
_EXIT_WITHIN_S = STAYS_MIN * 60.0 + 5.0  # of the run's end, whatever happens
_ANSWERS_WITHIN_S, _BEGINS_WITHIN_S = 1.5, 15.0  # a bus that nobody has started here; one that a launcher brings now
_JOIN_WITHIN_S = 60.0  # the router is the first process of a run


def of_run(
    config: Config, folder: Path, descriptor: int, listening: socket.socket, name: str, keys: PageKeys | None
) -> None:
    """Serve the page that a launcher has started; it stays for as long as somebody looks, ten minutes at most.

    ``name`` is how browsers call this host; ``keys``: None where it is this computer's own.
    """
    os.nice(_NICE)
    clock, launcher = WallClock(), os.getppid()
    lifeline = Lifeline(descriptor, exit_within_s=_EXIT_WITHIN_S)

    def end_with_the_run() -> None:
        if lifeline.cut:
            raise SystemExit

    bus = joined(config.arena.name, config.bus.endpoint, PAGE, clock, _JOIN_WITHIN_S, end_with_the_run)
    served = Served(
        config=config, folder=folder, bus=bus, clock=clock, name=name, over=lambda: lifeline.cut, keys=keys,
        line=lambda: lifeline.newest_line, launcher_lives=lambda: os.getppid() == launcher,
        stays=lambda: lifeline.say(STAYS),
    )  # fmt: skip
    own: list[Addresses] = []

    def ready(at: Addresses) -> None:
        own.append(at)
        keep(config.arena.name, at)
        lifeline.ready(at.line())

    with closing(bus), lifeline.logged("web", config.arena.name):
        try:
            asyncio.run(serve(served, listening, ready, lambda: lifeline.by_signal))
        finally:
            for at in own:
                forget(config.arena.name, at)


def announced(at: Addresses, *, browser: bool) -> str:
    """Return how the operator's page is reached; open it in a browser, if that is wanted."""
    console = Console(stderr=True)
    opened = browser and console.is_terminal and open_page(at.once)
    if at.viewer and (code := qr_code(at.page, console)) is not None:
        console.print(code)
    return address_lines(at, opened=opened)


def projected(chosen: Sequence[ProjectorSettings], opened: ExitStack | None, at: Addresses) -> str:
    """Return how projectors' pages are reached, and the operator's, where they are switched.

    ``opened``: a kiosk's browser is to show the only one; None: people open them.
    """
    if opened is not None:
        try:
            (own,) = chosen
            opened.enter_context(kiosk(projector_address(at.once, own.name), (own.width, own.height)))
        except DisplayError as refused:
            raise RefusedError(str(refused)) from refused
        lines = [f"Chromium shows the projector {chosen[0].name}"]
    else:
        lines = [f"the projector {each.name}: {projector_address(at.viewer or at.page, each.name)}" for each in chosen]
    return "\n".join([*lines, f"switch what is shown on the operator's page: {at.page}"])


def until_over(page_run: There) -> None:
    """Wait for the end of a run, or for Ctrl-C."""
    over, clock, lifeline = Over(page_run), WallClock(), Lifeline(None)
    lifeline.ready("Ctrl-C closes it")
    while not (over() or lifeline.cut):
        clock.sleep_until(clock.now_ns() + _LOOK_NS)


def by_hand(
    page_run: There, listening: socket.socket, host: str, keys: PageKeys | None, announce: Callable[[Addresses], str]
) -> tuple[bool, str]:
    """Join a run and serve its page until Ctrl-C, or until the run is over and nobody looks.

    Returns whether it could be served, and the last words. ``keys``: None on this computer. ``announce`` returns what
    is printed when the page can be opened.
    """
    config, folder, run = page_run
    over = Over(page_run)

    def still_there() -> None:
        if over():
            raise RefusedError(how_ended(config, folder))

    clock, arena, endpoint = WallClock(), config.arena.name, config.bus.endpoint
    within_s = _ANSWERS_WITHIN_S if run is None else _BEGINS_WITHIN_S
    try:
        bus = joined(arena, endpoint, PAGE, clock, within_s, still_there)
    except TimeoutError as error:
        if run is not None:
            return False, f"the bus of {arena} at {endpoint} does not answer: end the run with `kill {run.pid}`"
        raise RefusedError(
            f"no run of {arena} answers at {endpoint}: start one with `robofleet run CONFIG --web`"
        ) from error
    with closing(bus):
        os.nice(_NICE)
        lifeline = Lifeline(None)
        served = Served(
            config=config,
            folder=folder,
            bus=bus,
            clock=clock,
            name=host,
            over=over,
            keys=keys,
            by_hand=True,
            launcher_lives=lambda: run is not None and Path(f"/proc/{run.pid}").exists(),
        )
        ending = asyncio.run(serve(served, listening, lambda at: lifeline.ready(announce(at)), lambda: lifeline.cut))
    return True, "" if ending.frame is None else how_ended(config, folder)
