"""What the page asks of the run."""

import asyncio
from collections.abc import Callable

from robofleet.bus.bus import Bus
from robofleet.core.clock import Clock
from robofleet.operator.asking import ESTOP, Asking, Outcome
from robofleet.operator.estop import Units
from robofleet.operator.page.frames import Frame, answer

RESET = "reset"
REQUESTS = ("arm", "start", "hold", "resume", "stop", RESET)
_MOST_REQUESTS = 8  # under way: more are refused


class Controls:
    """Asks the supervisor, and says what it answered. The emergency stop waits for no other request."""

    def __init__(self, bus: Bus, clock: Clock, units: Units) -> None:
        self._asking = Asking(bus, clock, units, at_once=2)
        self._under_way = 0
        self._begun: set[asyncio.Task[None]] = set()
        self.reset_ended: Callable[[], Outcome] | None = None  # after the run: then nobody is left to be asked
        self.close = self._asking.close

    def begin(self, what: str, tell: Callable[[Frame], None]) -> None:
        """Do it, and tell the answer; it is done also if who asked is gone before."""

        async def doing() -> None:
            tell(await self.do(what))

        task = asyncio.create_task(doing())
        self._begun.add(task)
        task.add_done_callback(self._begun.discard)

    async def do(self, what: str) -> Frame:
        """Ask for one of REQUESTS, or for the emergency stop; returns the answer, at the latest after two seconds."""
        if what == ESTOP:
            return answer(what, *await asyncio.wrap_future(self._asking(what)))
        if self._under_way >= _MOST_REQUESTS:
            return answer(what, False, "too much was asked at once: wait for the answers")
        self._under_way += 1
        try:
            if what == RESET and self.reset_ended is not None:
                return answer(what, *await asyncio.to_thread(self.reset_ended))
            done, text = await asyncio.wrap_future(self._asking(what))
        finally:
            self._under_way -= 1
        if not done and not text.startswith("refused: "):
            text += ": look at the robots; the emergency stop is the button, or the switch"
        return answer(what, done, text.removeprefix("refused: "))
