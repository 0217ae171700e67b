"""Tasks: what is trained for. The interface, what robots observe, and one file a task."""

from robofleet.behaviours.interface import Dots, Line, Shape, Team
from robofleet.core.settings import Model as Settings
from robofleet.policies.interface import Task, Term, View

__all__ = ["Dots", "Line", "Settings", "Shape", "Task", "Team", "Term", "View"]
