"""The gateway of a run in real time: one more client of its bus, which it may leave at any time."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from robofleet.clock import S, WallClock, epoch_ns
from robofleet.comms.joining import joined
from robofleet.comms.permissions import SCRIPT
from robofleet.config.tree import Config
from robofleet.gateways.asking import Asking
from robofleet.gateways.place import Place, is_over
from robofleet.gateways.ros2 import services
from robofleet.gateways.ros2.gateway import NODE, Gateway

_JOINED_WITHIN_S = 3.0
_LOOK_S = 0.05  # at least so often it is seen what came
_SILENT_NS = 3 * S  # of the supervisor: then it is asked whether there is a run


@contextmanager
def node(namespace: str) -> Iterator[Node]:
    """Be a node of the graph. Signals are ours: SIGINT and SIGTERM end the gateway in order."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        made = rclpy.create_node(NODE, namespace=namespace, context=context)
        try:
            yield made
        finally:
            made.destroy_node()
    finally:
        signal.signal(signal.SIGTERM, before)
        rclpy.try_shutdown(context=context)


def serve(config: Config, place: Place, namespace: str) -> None:
    """Serve a run until it ends, or until SIGINT; TimeoutError where its bus does not answer."""
    clock = WallClock()
    bus = joined(
        config.arena.name, place.endpoint, SCRIPT, clock, _JOINED_WITHIN_S, credentials=place.credentials
    )  # fmt: skip
    asking = Asking(bus, clock, config)
    try:
        with node(namespace) as made, suppress(KeyboardInterrupt, ExternalShutdownException):
            executor = SingleThreadedExecutor(context=made.context)
            executor.add_node(made)
            gateway = Gateway(made, config, bus, clock, epoch_ns)
            services.serve(made, asking)
            made.create_timer(_LOOK_S, gateway.step)
            print(f"ROS 2 hears the run of {config.arena.name}: Ctrl-C ends this, and not the run", file=sys.stderr)
            while clock.now_ns() - gateway.run.state_ns < _SILENT_NS or not is_over(config, place):
                executor.spin_once(timeout_sec=_LOOK_S)
    finally:
        asking.close()
        bus.close()
