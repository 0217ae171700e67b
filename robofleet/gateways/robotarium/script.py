"""A script before it runs: which version of the Robotarium's interface it was written for."""

import ast
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TypeGuard

from robofleet.core.errors import RobofleetError

PACKAGE = "rps"
VERSIONS = 1, 2

# What only one of the versions has: methods, constants and keywords of a Robotarium, and names of its utilities.
_MEMBERS = {
    1: {
        "call_at_scripts_end", "set_leds", "set_left_leds", "set_right_leds", "time_step", "boundaries", "axes",
        "figure", "robot_diameter", "wheel_radius", "base_length", "max_linear_velocity", "max_angular_velocity",
        "max_wheel_velocity", "robot_radius", "robot_length", "robot_width", "collision_diameter", "collision_offset",
        "poses", "velocities",
    },
    2: {
        "debug", "initialize", "get_distances", "get_distance_endpoints", "get_accelerations", "get_gyros",
        "get_magnetic_fields", "get_orientations", "get_encoders", "robot_colormap", "_axes_handle", "_fig",
        "TIME_STEP", "BOUNDARIES", "ROBOT_DIAMETER", "WHEEL_RADIUS", "BASE_LENGTH", "MAX_LINEAR_VELOCITY",
        "MAX_ANGULAR_VELOCITY", "MAX_WHEEL_VELOCITY", "COLLISION_DIAMETER", "COLLISION_OFFSET", "use_distance_sensors",
        "obstacles", "skip_initialization", "show_arena_boundaries", "show_robot_patches", "show_distance_endpoints",
        "show_distance_rays", "show_obstacles",
    },
}  # fmt: skip
_UTILITIES = {
    1: {
        "at_pose", "at_position", "create_clf_unicycle_pose_controller", "create_clf_unicycle_position_controller",
        "create_hybrid_unicycle_pose_controller", "create_robust_barriers",
        "create_single_integrator_barrier_certificate", "create_single_integrator_barrier_certificate2",
        "create_single_integrator_barrier_certificate_with_boundary", "create_uni_to_si_dynamics",
        "create_unicycle_barrier_certificate", "create_unicycle_barrier_certificate2",
        "create_unicycle_barrier_certificate_with_boundary", "create_unicycle_differential_drive_barrier_certificate",
        "create_unicycle_differential_drive_barrier_certificate_with_boundary", "cycle_GL", "determine_marker_size",
        "generate_initial_conditions",
    },
    2: {
        "create_at_pose", "create_at_position", "create_pose_controller_clf", "create_pose_controller_hybrid",
        "create_pose_parking_controller_clf", "create_pose_parking_controller_hybrid", "create_si_barrier_certificate",
        "create_si_barrier_certificate_with_boundary", "create_uni_barrier_certificate",
        "create_uni_barrier_certificate_with_boundary", "create_uni_position_controller", "create_uni_to_si_mapping",
        "cycleGL", "generate_initial_poses", "generate_random_poses", "generate_random_positions", "rotation_matrix",
        "simulate_distance_sensors", "unique_filename",
    },
}  # fmt: skip
_ABSTRACT = {1: "RobotariumABC", 2: "ARobotarium"}  # classes of the installed package's rps/robotarium_abc.py


class ScriptError(RobofleetError):
    """Raised where a script cannot be run. The message says why, and what to do."""


def installed() -> Path:
    """Return the folder of the installed package of the Robotarium; ScriptError where there is none."""
    found = PathFinder.find_spec(PACKAGE)
    places = [] if found is None else list(found.submodule_search_locations or ())
    if not places:
        raise ScriptError(
            f"this needs the Robotarium's package {PACKAGE}, whose utilities scripts use: "
            "pip install git+https://github.com/robotarium/robotarium_python_simulator, "
            "and for scripts of version 1 the same with @6bb184e behind it"
        )
    return Path(places[0])


def version_of(source: str, name: str) -> int | None:
    """Return the version that a script was written for; None where it names nothing that only one version has.

    ScriptError where it names things of both. SyntaxError as Python has it.
    """
    members, utilities = _named(ast.parse(source, name))
    found = {version: sorted(members & _MEMBERS[version] | utilities & _UTILITIES[version]) for version in VERSIONS}
    if all(found.values()):
        raise ScriptError(
            f"{name} has {found[1][0]!r} of version 1, {found[2][0]!r} of version 2: say --api 1 or --api 2"
        )
    return next((version for version, names in found.items() if names), None)


def version_installed(package: Path) -> int:
    file = package / "robotarium_abc.py"
    try:
        defined = {node.name for node in ast.parse(file.read_text()).body if isinstance(node, ast.ClassDef)}
    except (OSError, SyntaxError, ValueError):
        return VERSIONS[-1]
    return next((version for version, name in _ABSTRACT.items() if name in defined), VERSIONS[-1])


def _named(tree: ast.AST) -> tuple[set[str], set[str]]:
    """Return what a script names of a Robotarium, and the functions that it calls or imports and does not define."""
    nodes = list(ast.walk(tree))
    made = [node for node in nodes if isinstance(node, ast.Assign) and _is_robotarium(node.value)]
    robotariums = {_last(target) for node in made for target in node.targets}
    members = {node.attr for node in nodes if isinstance(node, ast.Attribute) and _last(node.value) in robotariums}
    utilities, own = set[str](), set[str]()
    for node in nodes:
        match node:
            case ast.ImportFrom(module=str(module), names=imported) if module.partition(".")[0] == PACKAGE:
                utilities |= {alias.name for alias in imported}
            case ast.Call(func=ast.Name(id=name)):
                utilities.add(name)
            case ast.Call(func=ast.Attribute(value=ast.Name(), attr=name)) if name in _UTILITIES[1] | _UTILITIES[2]:
                utilities.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.Name(id=name, ctx=ast.Store()):
                own.add(name)
            case _:
                pass
        if _is_robotarium(node):
            members |= {keyword.arg for keyword in node.keywords if keyword.arg}
    return members, utilities - own


def _is_robotarium(node: ast.AST) -> TypeGuard[ast.Call]:
    return isinstance(node, ast.Call) and _last(node.func) == "Robotarium"


def _last(node: ast.AST) -> str:
    """Return the last name of ``a.b.c``."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")
