"""How old a message is whose sender has a clock of its own: without a comparison of two clocks."""

from robofleet.core.clock import MS, S

_DRIFT = 10_000  # two clocks drift apart by less than this part of the time that passes
_SET_NS = 100 * MS  # who is faster than the fastest by more has set its clock
_DOUBT_NS = S  # so long after that no age is known
UNKNOWN_NS = 60 * S  # older than any command that is done (``silent_s``)


class Ages:
    """Of the messages on one topic.

    The fastest message so far shows how far two clocks are apart, together with the shortest way. What took longer is
    older by that: held back on its way, by its sender's computer, or by this process. The clocks' drift alone makes
    that difference grow: a way that becomes slow, and stays so, makes every message old.

    A message that was sent before the one before it, or that is faster than any clock drifts, is of a sender whose
    clock was set, or of another one. Its way is not known then: all is old until a second has passed without such a
    jump. So of two senders that alternate, with clocks that differ, none is believed.
    """

    def __init__(self) -> None:
        self._fastest_ns: int | None = None  # from the sender's clock to ours
        self._sent_ns = self._came_ns = 0
        self._known_ns = 0  # from when on ages are known
        self._other = False  # the next message may be another sender's

    def expect_another(self) -> None:
        """Expect another sender: whose next message is slower by more than clocks drift has another clock."""
        self._other = True

    def age_ns(self, sent_ns: int, came_ns: int) -> int:
        """Return how old a message is that was sent at an instant of its sender's clock and came at one of ours."""
        way_ns = came_ns - sent_ns
        if self._fastest_ns is None:
            self._fastest_ns = way_ns
        else:
            self._fastest_ns += (came_ns - self._came_ns) // _DRIFT
            longer_ns = way_ns - self._fastest_ns
            if sent_ns < self._sent_ns or longer_ns < -_SET_NS or (self._other and longer_ns > _SET_NS):
                self._fastest_ns, self._known_ns = way_ns, came_ns + _DOUBT_NS
        self._sent_ns, self._came_ns, self._other = sent_ns, came_ns, False
        self._fastest_ns = min(self._fastest_ns, way_ns)
        return way_ns - self._fastest_ns if came_ns >= self._known_ns else UNKNOWN_NS
