"""What settings are made of, those of the configuration and those of behaviours: a frozen model, numbers with limits.

Every number has a least and a greatest value: what is outside exists in no laboratory, and would overflow or divide by
nothing somewhere far from the line that says it. Every text and every list has a longest.
"""

from typing import Annotated, Any, Literal, NamedTuple, TypeGuard

from pydantic import BaseModel, ConfigDict, Field

from robofleet.core.patterns import NAME_PATTERN


class Family(NamedTuple):
    """A family of AprilTags. The side of a tag, wherever one is given, is that of its square.

    All rings of cells around the square have the same greys in each of its tags, or hold bits.
    """

    cells: int  # along the whole print
    square: int  # along the square that is black in white, or white in black
    white: bool  # the square's rim: white in black
    ids: int
    distance: int  # bits by which any two tags differ
    alike: float  # least correlation of a tag that is followed: above that of any two

    @property
    def whole(self) -> float:
        """The side of the whole print [sides]."""
        return self.cells / self.square

    @property
    def named(self) -> str:
        """What a user measures the side of."""
        return "white square in the black one" if self.white else "black square"


FamilyName = Literal["36h11", "25h9", "16h5", "Standard41h12"]
FAMILIES: dict[str, Family] = {
    "36h11": Family(8, 8, False, 587, 11, 0.8),
    "25h9": Family(7, 7, False, 35, 9, 0.8),
    "16h5": Family(6, 6, False, 30, 5, 0.87),
    "Standard41h12": Family(9, 5, True, 2115, 12, 0.85),
}


def is_family(name: str) -> TypeGuard[FamilyName]:
    return name in FAMILIES


LAST_TAG = max(family.ids for family in FAMILIES.values()) - 1  # of the largest family
TAGS = LAST_TAG + 1  # so many robots can a camera tell apart
CAMERAS = 16  # of an arena
ROBOTS = 2048  # of a fleet
MANY = 10_000  # of anything in a list


def within(low: float, high: float) -> Any:
    return Field(ge=low, le=high)


Positive = Annotated[float, Field(ge=1e-9, le=1e9, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Gray = Annotated[int, Field(ge=0, le=255)]
Pixels = Annotated[int, Field(ge=1, le=16384)]  # along a side of an image
Count = Annotated[int, Field(ge=0, le=10**9)]

Length = Annotated[float, within(1e-3, 1000)]  # of a part of a robot, or of a tag [m]; one in mm is said elsewhere
Height = Annotated[float, within(0, 100)]  # above the floor [m]
Coordinate = Annotated[float, within(-1000, 1000)]  # in the world [m]
Degrees = Annotated[float, within(-360, 360)]
Lag = Annotated[float, within(0, 10)]  # time constant of a motor [s]
Delay = Annotated[float, within(0, 1)]  # of a command, an image [s]
Lateness = Annotated[float, within(1e-6, 1e4)]  # that is done to something on purpose [s]
Instant = Annotated[float, within(0, 1e9)]  # since a start [s]
Lasting = Annotated[float, within(1e-6, 1e9)]  # [s]
Noise = Annotated[float, within(1e-9, 10)]  # standard deviation [m or rad]

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Text = Annotated[str, Field(max_length=4096)]
Named = Annotated[str, Field(min_length=1, max_length=4096)]  # a file, an entry point or a class


class Model(BaseModel):
    """A frozen part of the tree; unknown keys are refused, and a number must be a number.

    What stands below a key describes it: in ``configs/keys``, and in the schema that editors read.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True, allow_inf_nan=False
    )
