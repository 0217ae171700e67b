"""A script before it runs: which version of the Robotarium's interface it was written for."""

import ast
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGE = "rps"
VERSIONS = 1, 2

# What only one of the versions has, as scripts name it: methods and constants of a Robotarium, names that they import.
_OF_1 = {
    "call_at_scripts_end", "set_leds", "set_left_leds", "set_right_leds", "time_step", "boundaries", "robot_diameter",
    "wheel_radius", "base_length", "max_linear_velocity", "max_angular_velocity", "max_wheel_velocity", "robot_radius",
    "robot_length", "robot_width", "collision_diameter", "collision_offset", "generate_initial_conditions", "at_pose",
    "at_position", "cycle_GL", "completeGL_", "create_clf_unicycle_pose_controller",
    "create_clf_unicycle_position_controller", "create_hybrid_unicycle_pose_controller",
    "create_single_integrator_barrier_certificate", "create_single_integrator_barrier_certificate2",
    "create_single_integrator_barrier_certificate_with_boundary", "create_unicycle_barrier_certificate",
    "create_unicycle_barrier_certificate2", "create_unicycle_barrier_certificate_with_boundary",
    "create_unicycle_differential_drive_barrier_certificate",
    "create_unicycle_differential_drive_barrier_certificate_with_boundary", "determine_marker_size",
}  # fmt: skip
_OF_2 = {
    "debug", "initialize", "get_distances", "get_distance_endpoints", "get_accelerations", "get_gyros",
    "get_magnetic_fields", "get_orientations", "get_encoders", "robot_colormap", "_axes_handle", "_fig",
    "TIME_STEP", "BOUNDARIES", "ROBOT_DIAMETER", "WHEEL_RADIUS", "BASE_LENGTH", "MAX_LINEAR_VELOCITY",
    "MAX_ANGULAR_VELOCITY", "MAX_WHEEL_VELOCITY", "COLLISION_DIAMETER", "COLLISION_OFFSET", "generate_initial_poses",
    "generate_random_poses", "generate_random_positions", "create_at_pose", "create_at_position", "cycleGL",
    "create_si_barrier_certificate", "create_si_barrier_certificate_with_boundary", "create_uni_barrier_certificate",
    "create_uni_barrier_certificate_with_boundary", "create_uni_position_controller", "create_pose_controller_clf",
    "create_pose_controller_hybrid", "create_pose_parking_controller_clf", "create_pose_parking_controller_hybrid",
    "use_distance_sensors", "obstacles", "skip_initialization", "show_arena_boundaries", "show_robot_patches",
    "show_distance_endpoints", "show_distance_rays", "show_obstacles",
}  # fmt: skip
_ABSTRACT = {1: "RobotariumABC", 2: "ARobotarium"}  # classes of the installed package's rps/robotarium_abc.py


class ScriptError(Exception):
    """A script that cannot be run; the message says why, and what to do."""


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
    names = _named(ast.parse(source, name))
    of_1, of_2 = sorted(names & _OF_1), sorted(names & _OF_2)
    if of_1 and of_2:
        raise ScriptError(f"{name} has {of_1[0]!r} of version 1 and {of_2[0]!r} of version 2: say --api 1 or --api 2")
    return 1 if of_1 else 2 if of_2 else None


def version_installed(package: Path) -> int:
    """Return the version of the installed package."""
    file = package / "robotarium_abc.py"
    try:
        defined = {node.name for node in ast.parse(file.read_text()).body if isinstance(node, ast.ClassDef)}
    except (OSError, SyntaxError, ValueError):
        return VERSIONS[-1]
    return next((version for version, name in _ABSTRACT.items() if name in defined), VERSIONS[-1])


def _named(tree: ast.AST) -> set[str]:
    """Return the attributes, imported names, called functions and keywords of a script, but not what it defines."""
    names, own = set[str](), set[str]()
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name):
                names.add(name)
            case ast.ImportFrom(module=module, names=imported) if (module or "").partition(".")[0] == PACKAGE:
                names |= {one.name for one in imported}
            case ast.Call(func=ast.Name(id=name)):
                names.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                own.add(name)
            case _:
                pass
        if isinstance(node, ast.Call) and _called(node) == "Robotarium":
            names |= {keyword.arg for keyword in node.keywords if keyword.arg}
    return names - own


def _called(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
