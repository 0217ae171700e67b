"""Environments: the arenas of a run, a thousand at once, as Gymnasium and PettingZoo have them.

Plant, wheels' limits, barrier, gates' ramps and the noise of poses are those of a run, configured by the same YAML.
The extra ``envs`` brings Gymnasium and PettingZoo. ``Episodes`` needs neither.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robofleet.config.tree import Config
from robofleet.core.refusal import need_extra
from robofleet.envs.episodes import Episodes, Step
from robofleet.policies import Task

if TYPE_CHECKING:
    from robofleet.envs.gymnasium import FleetEnv, VectorFleetEnv
    from robofleet.envs.pettingzoo import ParallelFleetEnv

__all__ = ["Episodes", "Step", "env", "parallel_env", "vector_env"]


def env(config: Config | Path | str, task: str | type[Task], **options: Any) -> "FleetEnv":
    """Return one arena as a Gymnasium environment: one agent decides for all robots.

    Args:
        config: A configuration, or its file.
        task: The task's name, ``module:Class``, or its class.
        options: As ``Episodes`` takes them: ``seed``, ``settings``, ``group``, ``randomise``, ``barrier``.

    Raises:
        BadInputError: Gymnasium is not installed, or the configuration is wrong.
    """
    need_extra("envs", "gymnasium")
    from robofleet.envs.gymnasium import FleetEnv  # noqa: PLC0415 - an extra

    return FleetEnv(Episodes(config, task, arenas=1, **options))


def vector_env(
    config: Config | Path | str, task: str | type[Task], *, arenas: int, each: str = "robot", **options: Any
) -> "VectorFleetEnv":
    """Return many arenas as a vectorised Gymnasium environment.

    Args:
        config: A configuration, or its file.
        task: The task's name, ``module:Class``, or its class.
        arenas: How many.
        each: What an agent is: a ``robot``, or an ``arena``.
        options: As ``env``.

    Raises:
        BadInputError: Gymnasium is not installed, or the configuration is wrong.
    """
    need_extra("envs", "gymnasium")
    from robofleet.envs.gymnasium import VectorFleetEnv  # noqa: PLC0415 - an extra

    return VectorFleetEnv(Episodes(config, task, arenas=arenas, **options), each=each)


def parallel_env(config: Config | Path | str, task: str | type[Task], **options: Any) -> "ParallelFleetEnv":
    """Return one arena as a PettingZoo environment, with an agent for each robot; arguments and errors as ``env``."""
    need_extra("envs", "gymnasium", "pettingzoo")
    from robofleet.envs.pettingzoo import ParallelFleetEnv  # noqa: PLC0415 - an extra

    return ParallelFleetEnv(Episodes(config, task, arenas=1, **options))
