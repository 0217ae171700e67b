"""What the page asks of the run. The emergency stop waits for nobody else's request: it has threads of its own."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from robofleet.bus.bus import Bus
from robofleet.bus.requests import asked
from robofleet.core.clock import Clock
from robofleet.operator.estop import emergency_stop
from robofleet.operator.page.frames import Frame, answer

ESTOP = "estop"
REQUESTS = ("arm", "start", "hold", "resume", "stop", "reset")
_MOST_REQUESTS = 8  # requests under way: more are refused


class Controls:
    """Asks the supervisor, and says what it answered."""

    def __init__(self, bus: Bus, clock: Clock, units: Mapping[str, Sequence[str]]) -> None:
        self._bus, self._clock, self._units = bus, clock, units
        self._stopping = ThreadPoolExecutor(4, "estop")
        self._asking = ThreadPoolExecutor(2, "ask")
        self._under_way = 0
        self._begun: set[asyncio.Task[None]] = set()

    def begin(self, what: str, tell: Callable[[Frame], None]) -> None:
        """Do it, and tell the answer; it is done also if who asked is gone before."""

        async def doing() -> None:
            tell(await self.do(what))

        task = asyncio.create_task(doing())
        self._begun.add(task)
        task.add_done_callback(self._begun.discard)

    async def do(self, what: str) -> Frame:
        """Ask for one of REQUESTS, or for the emergency stop; returns the answer, at the latest after two seconds."""
        loop = asyncio.get_running_loop()
        if what == ESTOP:
            return await loop.run_in_executor(self._stopping, self._stop)
        if self._under_way >= _MOST_REQUESTS:
            return answer(what, False, "too much was asked at once: wait for the answers")
        self._under_way += 1
        try:
            return await loop.run_in_executor(self._asking, self._ask, what)
        finally:
            self._under_way -= 1

    def _stop(self) -> Frame:
        stopped = emergency_stop(self._bus, self._clock, self._units)
        return answer(ESTOP, not stopped.silent, stopped.describe())

    def _ask(self, what: str) -> Frame:
        try:
            reply = asked(self._bus, self._clock, "supervisor", what.encode()).decode(errors="replace")
        except TimeoutError as error:
            return answer(what, False, f"{error}: look at the robots; the emergency stop is the button, or the switch")
        return answer(what, reply.startswith("ok"), reply.removeprefix("refused: "))

    def close(self) -> None:
        for pool in (self._stopping, self._asking):
            pool.shutdown(wait=False, cancel_futures=True)
