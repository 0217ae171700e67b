"""What a Create 2 streams every 15 ms: 19, the length, each packet's id and value, a checksum."""

import struct
from typing import NamedTuple

_BYTES, _UNSIGNED, _SIGNED, _COUNTERS = (7, 9, 10, 11, 12, 14, 34, 35), (25, 26), (41, 42), (43, 44)
PACKETS = _BYTES + _UNSIGNED + _SIGNED + _COUNTERS
"""Ids of what makes a frame, in its order."""
_LARGEST_VALUES = (15, 1, 1, 1, 1, 31, 3, 3)  # of the bytes' values; more is garbage that adds up
_FRAME = struct.Struct(">BB" + "BB" * len(_BYTES) + "BH" * 2 + "Bh" * 2 + "BH" * 2 + "B")
_HEADER = bytes((19, _FRAME.size - 3))


class Frame(NamedTuple):
    """What the robot streams, packet by packet."""

    touch: int  # right bumper 1, left bumper 2, right wheel dropped 4, left wheel dropped 8
    cliff_left: int
    cliff_front_left: int
    cliff_front_right: int
    cliff_right: int
    overcurrent: int  # left wheel 16, right wheel 8
    chargers: int
    mode: int
    charge: int  # [mAh]
    capacity: int  # [mAh]
    right_requested: int  # [mm/s] by the last drive direct that it took
    left_requested: int
    left_counts: int  # modulo 65536
    right_counts: int


class Stream:
    """Finds frames in what comes. It falls into step again after lost and changed bytes."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes."""
        self._bytes += data
        frames = []
        while len(self._bytes) >= _FRAME.size:
            frame = _frame(self._bytes[: _FRAME.size])
            if frame is None:
                start = self._bytes.find(_HEADER, 1)
                del self._bytes[: start if start > 0 else len(self._bytes) - 1]
            else:
                frames.append(frame)
                del self._bytes[: _FRAME.size]
        return frames


def _frame(data: bytearray) -> Frame | None:
    fields = _FRAME.unpack(data)
    ids, values = fields[2:-1:2], fields[3:-1:2]
    sound = data.startswith(_HEADER) and sum(data) % 256 == 0 and ids == PACKETS
    return Frame(*values) if sound and all(map(int.__le__, values, _LARGEST_VALUES)) else None
