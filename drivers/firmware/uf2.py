"""Turn the image of a Pico's flash into the file that its boot ROM takes on the drive RPI-RP2.

    python3 uf2.py IMAGE UF2

The format: github.com/microsoft/uf2. Each 256 bytes of the image are a block of 512.
"""

import struct
import sys
from pathlib import Path

FLASH, PAGE_BYTES, RP2040 = 0x10000000, 256, 0xE48BFF56
FAMILY_IS_GIVEN = 0x2000
BLOCK = struct.Struct("<8I 476s I")  # magic twice, flags, address, bytes, number, of how many, family; data; magic


def uf2(image: bytes) -> bytes:
    """Return the blocks that write ``image`` from the flash's first byte on; zeros fill the last page."""
    count = -(-len(image) // PAGE_BYTES)
    blocks = bytearray()
    for number in range(count):
        at = PAGE_BYTES * number
        header = 0x0A324655, 0x9E5D5157, FAMILY_IS_GIVEN, FLASH + at, PAGE_BYTES, number, count, RP2040
        blocks += BLOCK.pack(*header, image[at : at + PAGE_BYTES], 0x0AB16F30)
    return bytes(blocks)


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(uf2(Path(sys.argv[1]).read_bytes()))
