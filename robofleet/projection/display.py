"""What shows pictures: a simulated projector, or a browser on the computer that the projector hangs on."""

from typing import Protocol

from robofleet.core.arrays import Image
from robofleet.core.errors import RobofleetError


class DisplayError(RobofleetError):
    """Raised where pictures are not shown. The message says why, and the cure."""


class Display(Protocol):
    """Something that shows pictures."""

    def show(self, picture: Image) -> int:
        """Show a picture.

        Args:
            picture: Grey levels (H, W), of the projector's size.

        Returns:
            When it was drawn [ns; this host's clock]. Its light may come later, by the projector's own delay.

        Raises:
            DisplayError: Nobody shows it.
        """

    def close(self) -> None:
        """Show nothing more. Idempotent."""
