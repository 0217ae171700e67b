"""Sizes of what is drawn of a run: those of a projector's page and of a simulated projector's picture in units of the
floor, those of the operator's page in its pixels."""

SIZES = {
    "line": 2.0,  # a path's and a trail's width
    "edge": 1.5,  # the floor's and an obstacle's
    "thin": 1.0,  # of the way from a robot's point to its reference, and of the discs that the barrier keeps apart
    "cross": 4.0,  # at a reference: half of a side
    "direction": 6.0,  # a path's: an arrow, from its middle to its tip
    "directions": 8,  # of a path
    "dot": 4.0,  # a behaviour's: the radius
    "halo": 3.0,  # its width
    "bold_halo": 6.0,  # of a robot with which something is wrong
    "arrow": 7.0,  # where a robot heads: from its middle to its tip
    "units": 900.0,  # of the arena's length
    "large_units": 450.0,  # the same, where all is twice as large
    "trail_s": 4.0,
    "trail_ticks": 3,  # between two of its places
}


def unit_m(arena_m: float, *, large: bool) -> float:
    """Return the unit of the floor in an arena of some length [m]."""
    return arena_m / SIZES["large_units" if large else "units"]
