"""``python -m robofleet``: no module of the folder where it is called is taken for an installed one."""

import sys

if not sys.flags.safe_path:
    del sys.path[0]  # the current folder, which Python puts before all others

from robofleet.cli import main

main()
