"""The task navigation: as go_to, among the obstacles of the configuration, which distance sensors show."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from robofleet.behaviours.interface import Team
from robofleet.core.arrays import Array
from robofleet.core.settings import within
from robofleet.policies.go_to import GoTo
from robofleet.policies.interface import TaskView, Term
from robofleet.policies.observations import rays


class Navigation(GoTo):
    """Each robot to its goal, round obstacles."""

    class Settings(GoTo.Settings):
        """Keys of the task."""

        rays: Annotated[int, within(1, 360)] = 16
        """Distances that a robot observes, evenly all around. The first one is straight ahead."""

    settings: Settings
    duration_s = 60.0

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._bearings = np.linspace(0.0, 2.0 * np.pi, settings.rays, endpoint=False)

    @property
    def terms(self) -> Sequence[Term]:
        return *super().terms, Term("rays", self.settings.rays, "m", 1.0)

    def observe(self, view: TaskView) -> Sequence[Array]:
        return *super().observe(view), rays(view.poses, view.others, self.team, self._bearings, self.settings.range_m)
