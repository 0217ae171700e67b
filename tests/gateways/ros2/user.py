"""A node of a ROS 2 user, in a process of its own: what it hears and does is printed as JSON.

    python -m tests.gateways.ros2.user listen SECONDS     what is there, and what came
    python -m tests.gateways.ros2.user square             drives r1 round a square by its odometry; hold and resume
    python -m tests.gateways.ros2.user drive TYPE         drives r1 until it is killed
    python -m tests.gateways.ros2.user clock              drives r1 for two seconds of simulated time
    python -m tests.gateways.ros2.user count SECONDS answering|free     drives r1, each command with a speed of its own

It knows ROS 2 and the names in the gateway's README, and nothing of robofleet but clock and table.
"""

import json
import math
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy, qos_profile_sensor_data
from std_msgs.msg import String
from std_srvs.srv import Trigger

from robofleet.core.clock import MS, S, WallClock
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.ros2.topics import MAP, load

SIDE_M, V_M_S, OMEGA_RAD_S = 0.1, 0.12, 1.2
WITHIN_S = 30.0
CLOCK = WallClock()
_EVERY_NODES = "/rosout", "/parameter_events"
_LATCHED = QoSProfile(
    depth=1, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
)


def until(node: Node, true: Callable[[], Any], within_s: float = WITHIN_S) -> None:
    """Spin until something is true."""
    end_ns = CLOCK.now_ns() + round(within_s * S)
    while not true():
        assert CLOCK.now_ns() < end_ns, "it did not come"
        rclpy.spin_once(node, timeout_sec=0.05)


def listen(node: Node, seconds: float) -> dict[str, Any]:
    """Return the graph's topics with type, frames and quality, and how many messages of each came."""

    def of_gateway(ends: list[Any]) -> list[Any]:
        return [end for end in ends if end.node_name == "robofleet"]

    until(node, lambda: of_gateway(node.get_publishers_info_by_topic("/r1/odom")))  # known later than its topics
    found: dict[str, Any] = {}
    messages: dict[str, list[Any]] = {}
    kept = []
    end_ns = CLOCK.now_ns() + round(seconds * S)
    while CLOCK.now_ns() < end_ns:
        for name, (kind, *_) in node.get_topic_names_and_types():
            publishers = of_gateway(node.get_publishers_info_by_topic(name))
            subscribers = of_gateway(node.get_subscriptions_info_by_topic(name))
            if name in _EVERY_NODES or name in found or not (publishers or subscribers):
                continue
            (end,) = publishers or subscribers
            found[name] = {"type": kind, "quality": said(end.qos_profile), "flow": "out" if publishers else "in"}
            if publishers:
                latched = end.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
                came = messages.setdefault(name, [])
                quality = _LATCHED if latched else qos_profile_sensor_data
                kept.append(node.create_subscription(load(kind), name, came.append, quality))
        rclpy.spin_once(node, timeout_sec=0.05)
    for name, came in messages.items():
        found[name] |= {
            "messages": len(came),
            "frames": sorted({frame for message in came for frame in frames(message)}),
        }
    services = {name: kinds[0] for name, kinds in node.get_service_names_and_types()}
    return {"topics": found, "services": services}


def said(profile: QoSProfile) -> list[str]:
    """Return reliability and durability: what a graph tells of another node's quality."""
    return [profile.reliability.name.lower().replace("_", " "), profile.durability.name.lower().replace("_", " ")]


def frames(message: Any) -> set[str]:
    """Return the frames that a message names."""
    for many in ("transforms", "markers"):
        if hasattr(message, many):
            return {frame for part in getattr(message, many) for frame in frames(part)}
    names = {message.header.frame_id} if hasattr(message, "header") else set()
    return names | ({message.child_frame_id} if hasattr(message, "child_frame_id") else set())


class Square:
    """Drives r1 round a square; every command answers a pose."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.odom: list[Odometry] = []
        self.poses: list[PoseWithCovarianceStamped] = []
        self.states: list[str] = []
        self._command = node.create_publisher(TwistStamped, "/r1/cmd_vel", 1)
        self._kept = [
            node.create_subscription(Odometry, "/r1/odom", self.odom.append, 10),
            node.create_subscription(PoseWithCovarianceStamped, "/r1/pose", self.poses.append, 10),
            node.create_subscription(String, "/state", lambda message: self.states.append(message.data), _LATCHED),
        ]

    def drive(self) -> dict[str, Any]:
        until(self._node, lambda: self.odom and self.poses and self.states and self._command.get_subscription_count())
        corners = [self._pose()]
        answers = {"hold": self._ask("hold")}
        until(self._node, lambda: self.states[-1] == "hold")
        stood = self._moved_while(lambda: self._say(V_M_S, 0.0), 0.5)
        self._moved_while(lambda: None, 0.3)  # the newest command is too old by then
        answers["resume"] = self._ask("resume")
        until(self._node, lambda: self.states[-1] == "running")
        old = self._moved_while(lambda: self._say(V_M_S, 0.0, late_s=0.5), 0.5)
        nothing = self._moved_while(lambda: self._say(math.nan, 0.0), 0.3)
        headings = [corners[0][2]]
        for _ in range(4):
            self._until_there(lambda: SIDE_M - math.dist(self._pose()[:2], corners[-1][:2]), (V_M_S, 0.0))
            headings.append(headings[-1] + math.pi / 2.0)
            self._until_there(lambda: math.remainder(headings[-1] - self._pose()[2], math.tau), (0.0, OMEGA_RAD_S))
            corners.append(self._pose())
        stamps = [odometry.header.stamp.sec * S + odometry.header.stamp.nanosec for odometry in self.odom]
        return {
            "corners": corners, "told": answers, "stood_m": stood, "old_m": old, "nothing_m": nothing,
            "states": self.states, "odom": len(self.odom),
            "odom_frames": [self.odom[-1].header.frame_id, self.odom[-1].child_frame_id],
            "stamps_rise": all(a < b for a, b in pairwise(stamps)),
            "map": [odometry.header.frame_id == MAP for odometry in self.poses].count(True),
            "pose": _planar(self.poses[-1].pose.pose), "first_pose": _planar(self.poses[0].pose.pose),
        }  # fmt: skip

    def _pose(self) -> tuple[float, float, float]:
        return _planar(self.odom[-1].pose.pose)

    def _until_there(self, left: Callable[[], float], velocity: tuple[float, float]) -> None:
        """Drive at a velocity until nothing is left, slower at the end."""
        seen = len(self.poses)
        end_ns = CLOCK.now_ns() + round(WITHIN_S * S)
        while (rest := left()) > 0.004:
            assert CLOCK.now_ns() < end_ns, f"{rest} is left"
            if len(self.poses) > seen:
                seen = len(self.poses)
                share = min(1.0, 4.0 * rest / max(velocity) + 0.1)
                self._say(velocity[0] * share, velocity[1] * share)
            rclpy.spin_once(self._node, timeout_sec=0.05)

    def _say(self, v: float, omega: float, late_s: float = 0.0) -> None:
        message = TwistStamped()
        message.header.stamp = (self._node.get_clock().now() - Duration(seconds=late_s)).to_msg()
        message.twist.linear.x, message.twist.angular.z = v, omega
        self._command.publish(message)

    def _moved_while(self, do: Callable[[], None], seconds: float) -> float:
        before, end_ns = self._pose(), CLOCK.now_ns() + round(seconds * S)
        while CLOCK.now_ns() < end_ns:
            do()
            rclpy.spin_once(self._node, timeout_sec=0.03)
        return math.dist(before[:2], self._pose()[:2])

    def _ask(self, what: str) -> list[Any]:
        client = self._node.create_client(Trigger, what)
        assert what in SERVICES and client.wait_for_service(timeout_sec=WITHIN_S)
        answer = client.call_async(Trigger.Request())
        until(self._node, answer.done)
        return [answer.result().success, answer.result().message]


def _planar(pose: Any) -> tuple[float, float, float]:
    return pose.position.x, pose.position.y, 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)


def drive(node: Node, kind: str) -> None:
    """Drive r1 until somebody kills this; the instant of each command is printed."""
    kind_class = {"TwistStamped": TwistStamped, "Twist": Twist}[kind]
    command = node.create_publisher(kind_class, "/r1/cmd_vel", 1)
    until(node, command.get_subscription_count)
    while True:
        message = kind_class()
        (message if kind == "Twist" else message.twist).angular.z = OMEGA_RAD_S
        print(CLOCK.now_ns(), flush=True)
        command.publish(message)
        CLOCK.sleep_until(CLOCK.now_ns() + 30 * MS)


def clock(node: Node) -> dict[str, Any]:
    """Drive r1 for two seconds of the time that ``/clock`` tells."""
    odom = list[Odometry]()
    kept = node.create_subscription(Odometry, "/r1/odom", odom.append, 10)
    command = node.create_publisher(TwistStamped, "/r1/cmd_vel", 1)
    now = node.get_clock().now
    until(node, lambda: odom and now().nanoseconds and command.get_subscription_count())
    before, began_ns, times = odom[-1], now().nanoseconds, list[int]()

    def drive() -> bool:
        message = TwistStamped()
        message.header.stamp = now().to_msg()
        message.twist.linear.x = V_M_S
        command.publish(message)
        times.append(now().nanoseconds)
        return times[-1] > began_ns + 2 * S

    until(node, drive)
    moved = math.dist(_planar(before.pose.pose)[:2], _planar(odom[-1].pose.pose)[:2])
    late_ns = now().nanoseconds - (odom[-1].header.stamp.sec * S + odom[-1].header.stamp.nanosec)
    node.destroy_subscription(kept)
    return {"moved_m": moved, "clock_s": began_ns / S, "rises": times == sorted(times), "odom_late_s": late_ns / S}


def count(node: Node, seconds: float, how: str) -> list[int]:
    """Drive r1, by a command for each of its poses or whenever 30 ms are over; returns when each was published [ns].

    The speed tells which command it is: ``speed``.
    """
    command, sent = node.create_publisher(TwistStamped, "/r1/cmd_vel", 1), list[int]()

    def say(_: Any = None) -> None:
        message = TwistStamped()
        message.twist.linear.x = speed(len(sent))
        sent.append(CLOCK.now_ns())
        command.publish(message)

    until(node, command.get_subscription_count)
    kept = (
        node.create_timer(0.03, say)
        if how == "free"
        else node.create_subscription(PoseWithCovarianceStamped, "/r1/pose", say, 1)
    )
    end_ns = CLOCK.now_ns() + round(seconds * S)
    while kept and CLOCK.now_ns() < end_ns:
        rclpy.spin_once(node, timeout_sec=0.05)
    return sent


def speed(number: int) -> float:
    """Return the speed of a numbered command [m/s]."""
    return 0.02 + 1e-5 * number


def main() -> None:
    rclpy.init()
    what, *more = sys.argv[1:]
    simulated = [Parameter("use_sim_time", value=what == "clock")]
    node = rclpy.create_node("user", parameter_overrides=simulated)
    if what == "drive":
        drive(node, *more)
    elif what == "listen":
        found: Any = listen(node, float(*more))
    elif what == "clock":
        found = clock(node)
    elif what == "count":
        found = count(node, float(more[0]), more[1])
    else:
        found = Square(node).drive()
    print(json.dumps(found), flush=True)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
