"""``robofleet sheet``, from a checkout: python tools/tag_sheet.py --help."""

from packages import needing

with needing("lab"):
    from robofleet.cli import main

if __name__ == "__main__":
    main("sheet")
