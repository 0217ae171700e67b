"""Names the silence of a pose source that follows no trigger: poses that do not come say nothing by themselves."""

from robofleet.core.clock import MS, S
from robofleet.tracking.events import Notice, TrackerEvent
from robofleet.tracking.sources import Observation, PoseSource

_SILENT_NS = 150 * MS  # named before the tracker itself counts as silent
_FIRST_NS = 3 * S  # within which a source that was just opened gives its first poses


class WatchedPoses:
    """A pose source whose silence is told once, as POSES_SILENT, and its end, as POSES_BACK."""

    def __init__(self, source: PoseSource, now_ns: int) -> None:
        self._source = source
        self._heard_ns = now_ns
        self._deadline_ns: int | None = now_ns + _FIRST_NS
        self._news: list[Notice] = []

    def next_ns(self) -> int | None:
        """Return when the next observation will be ready, or silence is to be told."""
        times = [at_ns for at_ns in (self._source.next_ns(), self._deadline_ns) if at_ns is not None]
        return min(times, default=None)

    def observe(self, now_ns: int) -> Observation | None:
        """Return the observation that is ready, or None."""
        observation = self._source.observe(now_ns)
        if observation is not None:
            if self._deadline_ns is None:
                self._news.append(Notice(TrackerEvent.POSES_BACK, value=(now_ns - self._heard_ns) / S))
            self._heard_ns, self._deadline_ns = now_ns, now_ns + _SILENT_NS
        elif self._deadline_ns is not None and now_ns >= self._deadline_ns:
            self._deadline_ns = None
            self._news.append(Notice(TrackerEvent.POSES_SILENT, value=(now_ns - self._heard_ns) / S))
        return observation

    def news(self) -> tuple[Notice, ...]:
        """Return what happened since the last call."""
        news = self._source.news() + tuple(self._news)
        self._news.clear()
        return news

    def close(self) -> None:
        """Let go of the source."""
        self._source.close()
