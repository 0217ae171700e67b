"""The services: what an operator asks of a run."""

from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.task import Future

from robofleet.gateways.asking import SERVICES, Ask
from robofleet.gateways.ros2.topics import SERVICE, load


def serve(node: Node, ask: Ask) -> None:
    """Serve them; the node goes on while one is answered."""

    async def answer(what: str, _request: Any, response: Any) -> Any:
        outcome: Future = Future(executor=node.executor)
        ask(what).add_done_callback(lambda done: None if done.cancelled() else outcome.set_result(done.result()))
        response.success, response.message = await outcome
        return response

    for what in SERVICES:
        node.create_service(load(SERVICE), what, partial(answer, what))
