"""What every part of the configuration is made of: a frozen model, and numbers that cannot be impossible."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from robofleet.config.patterns import NAME_PATTERN

LAST_TAG = 586  # AprilTag 36h11 has 587 ids
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Gray = Annotated[int, Field(ge=0, le=255)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Vector2 = Annotated[tuple[Finite, Finite], Field(strict=False)]
Vector3 = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]


class Model(BaseModel):
    """A frozen part of the tree; unknown keys are refused, and a number must be a number.

    What stands below a key describes it: in ``configs/README.md``, and in the schema that editors read.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)
