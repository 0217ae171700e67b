"""The gateway of a run in real time: one more client of its bus, which it may leave at any time."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress

import rclpy
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from robofleet.behaviours.ros2 import Ros2
from robofleet.bus.permissions import SCRIPT
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import WallClock, epoch_ns
from robofleet.core.refusal import RefusedError
from robofleet.gateways.asking import Asking
from robofleet.gateways.place import ArenaAccess, Served, is_over, joined_bus, joined_otherwise
from robofleet.gateways.ros2.gateway import NODE, Gateway, serve_requests
from robofleet.operator.terminal.terminal import interrupts

_POLL_S = 0.05


@contextmanager
def node(namespace: str) -> Iterator[Node]:
    """Be a node of the graph, which leaves signals alone; RefusedError where there can be none."""
    context = rclpy.Context()
    try:
        try:
            rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
            made = rclpy.create_node(NODE, namespace=namespace, context=context)
        except InvalidNamespaceException as error:
            raise RefusedError(f"--namespace {namespace}: {_line(error)}") from error
        except RuntimeError as error:  # RCLError: what ROS reads of the environment
            raise RefusedError(f"ROS 2 does not start: {_line(error)}: see `env | grep ROS`") from error
        try:
            yield made
        finally:
            made.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def _line(error: Exception) -> str:
    return " ".join(str(error).split()).partition(", at /")[0]


def serve(config: Config, access: ArenaAccess, namespace: str) -> None:
    """Serve a run until it ends, or a signal comes; TimeoutError if its bus does not answer, RefusedError as ``node``.

    The bus wakes the node, so it is left before the node is destroyed.
    """
    clock = WallClock()
    with ExitStack() as held:
        interrupted = held.enter_context(interrupts())
        made = held.enter_context(node(namespace))
        held.enter_context(suppress(ExternalShutdownException))
        bus = held.enter_context(closing(joined_bus(config, access, SCRIPT, clock)))
        asking = held.enter_context(closing(Asking(bus, clock, config.units, access.role)))
        executor = SingleThreadedExecutor(context=made.context)
        executor.add_node(made)
        served = Served(lambda: is_over(config, access), clock.now_ns())
        gateway = Gateway(made, config, bus, clock, epoch_ns, served)
        held.callback(gateway.velocities.stand)
        serve_requests(made, asking)
        made.create_timer(_POLL_S, gateway.step)
        if groups.taking_setpoints(config, Ros2) and (why := joined_otherwise(config, access, SCRIPT)):
            print(why, file=sys.stderr)
        print(f"ROS 2 hears the run of {config.arena.name}: Ctrl-C ends this, and not the run", file=sys.stderr)
        while not interrupted.count and not served.is_over(clock.now_ns()):
            executor.spin_once(timeout_sec=_POLL_S)
