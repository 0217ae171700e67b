"""URDF of a robot, for RViz, Nav2, Foxglove and rerun: its body, and its wheels with their joints."""

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from robofleet.config import slices
from robofleet.config.robots import Robot

BASE, WHEELS = "base_link", ("left_wheel", "right_wheel")  # links `{}_link` and joints `{}_joint` of the wheels
HEIGHT_M = 0.08  # of a body as it is drawn: the configuration does not know it
_WHEEL_WIDTH = 0.5  # of a wheel as it is drawn, in radii


def urdf(robot: Robot) -> str:
    """Return a robot's URDF; the frame ``base_link`` is on the floor under the middle of the axle (REP 105)."""
    drive, body_radius_m = slices.drive(robot), robot.vehicle.body_radius_m
    whole = Element("robot", name=robot.driver.replace(":", "_"))
    base = SubElement(whole, "link", name=BASE)
    for part in ("visual", "collision"):
        _cylinder(base, part, body_radius_m, HEIGHT_M, f"0 0 {HEIGHT_M / 2.0:g}", "0 0 0")
    for name, side in zip(WHEELS, (1.0, -1.0), strict=True):
        link = SubElement(whole, "link", name=f"{name}_link")
        _cylinder(link, "visual", drive.wheel_radius, _WHEEL_WIDTH * drive.wheel_radius, "0 0 0", f"{math.pi / 2} 0 0")
        joint = SubElement(whole, "joint", name=f"{name}_joint", type="continuous")
        SubElement(joint, "parent", link=BASE)
        SubElement(joint, "child", link=f"{name}_link")
        SubElement(joint, "origin", xyz=f"0 {side * drive.wheel_base / 2.0:g} {drive.wheel_radius:g}", rpy="0 0 0")
        SubElement(joint, "axis", xyz="0 1 0")
        SubElement(joint, "limit", effort="0", velocity=f"{drive.max_wheel_speed:g}")
    ElementTree.indent(whole)
    return ElementTree.tostring(whole, encoding="unicode") + "\n"


def _cylinder(link: Element, part: str, radius_m: float, length_m: float, xyz: str, rpy: str) -> None:
    """Add a cylinder to a link: what is seen of it (visual), or what it touches (collision)."""
    shape = SubElement(link, part)
    SubElement(shape, "origin", xyz=xyz, rpy=rpy)
    SubElement(SubElement(shape, "geometry"), "cylinder", radius=f"{radius_m:g}", length=f"{length_m:g}")
