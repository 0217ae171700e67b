"""The root of the exceptions that users see."""


class RobofleetError(Exception):
    """The root of robofleet's exceptions: never raised itself, so that a caller can catch all of them."""


class BadInputError(RobofleetError):
    """Bad input: one line a fault, with the position and the cure. A command ends with exit code 2."""
