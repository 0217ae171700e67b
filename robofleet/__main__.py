"""``python -m robofleet``."""

from robofleet.cli import main

main()
