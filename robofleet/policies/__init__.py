"""Tasks: what is trained for, and policies: what was trained. One file a task."""

from robofleet.behaviours.interface import Dots, Line, Shape, Team
from robofleet.core.settings import Model as Settings
from robofleet.policies.description import Description, PolicyError, described, save_policy
from robofleet.policies.interface import Task, TaskView, Term
from robofleet.policies.network import Policy, load_policy
from robofleet.policies.torch_export import export_torch

__all__ = [
    "Description",
    "Dots",
    "Line",
    "Policy",
    "PolicyError",
    "Settings",
    "Shape",
    "Task",
    "TaskView",
    "Team",
    "Term",
    "described",
    "export_torch",
    "load_policy",
    "save_policy",
]  # fmt: skip
