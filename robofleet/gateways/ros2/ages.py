"""How old a message is whose sender has a clock of its own: without a comparison of two clocks."""

from collections import deque

_WINDOW = 64  # messages


class Ages:
    """Of the messages of one sender.

    The fastest of the newest 64 messages shows how far two clocks are apart, together with the shortest way. What took
    longer is older by that: held back on its way, by its sender's computer, or by this process.
    """

    def __init__(self) -> None:
        self._delays: deque[int] = deque(maxlen=_WINDOW)

    def age_ns(self, sent_ns: int, came_ns: int) -> int:
        """Return how old a message is that was sent at an instant of its sender's clock and came at one of ours."""
        self._delays.append(came_ns - sent_ns)
        return came_ns - sent_ns - min(self._delays)
