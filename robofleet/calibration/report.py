"""The page about a calibration."""

from pathlib import Path

from robofleet.calibration.store import CalibrationError
from robofleet.clock import utc_now
from robofleet.pages import Page


class Report(Page):
    """A page of today."""

    def __init__(self, title: str) -> None:
        """Begin a page."""
        super().__init__(title, utc_now().isoformat(timespec="seconds"))

    def write(self, file: Path) -> None:
        """Write the page; CalibrationError if it cannot be."""
        try:
            super().write(file)
        except OSError as error:
            raise CalibrationError(f"{file}: cannot be written: {error.strerror}") from error
