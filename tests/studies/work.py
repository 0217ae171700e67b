"""Work for engines: worker processes import it."""

import os


def squared(number: int) -> int:
    """Return the square; 3 is refused, and 5 kills its worker."""
    if number == 3:
        raise ValueError("three\nis odd")
    if number == 5:
        os._exit(1)
    return number * number
