"""The root of the exceptions that users see."""


class RobofleetError(Exception):
    """The root of all exceptions of robofleet. It is never raised itself: catch it to catch all of them."""


class BadInputError(RobofleetError):
    """Raised for bad input: one line for each fault, with its position and cure. A command ends with exit code 2."""


class UnknownMeaningError(RobofleetError, TypeError):
    """Raised where a function reads a value of which nobody can tell whether it changed. The message names both."""
