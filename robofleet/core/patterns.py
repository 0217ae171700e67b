"""What names and endpoints look like. Nothing heavy is imported here: `robofleet stop` reads these too."""

NAME_PATTERN = r"^[a-z][a-z0-9_-]{0,31}$"
OVERHEAD = "overhead"  # the name of a camera that has no other
PRIVATE = "private"  # the endpoint that needs no name: a socket in this user's private folder
TCP, SOCKET = "tcp/", "unixsock-stream/"
ENDPOINT_PATTERN = rf"^({PRIVATE}|{SOCKET}/[^\s?#;]+|{TCP}[^\s/?#;]+:\d{{1,5}})$"
TLS, QUIC = "tls/", "quic/"  # links beyond this computer, by certificates
NETWORK_PATTERN = rf"^({TLS}|{QUIC})[^\s/?#;]+:\d{{1,5}}$"
LONGEST_SOCKET_PATH = 107  # [bytes] that the system takes


_DRIVER = "driver-"
TRACKER = "tracker"  # the process of the only camera


def driver_role(unit: str) -> str:
    """Return what the process of a unit is called: among the living, in its log, in faults that strike it."""
    return f"{_DRIVER}{unit}"


def tracker_role(camera: str) -> str:
    """Return what the tracker process of one of several cameras is called."""
    return f"{TRACKER}-{camera}"


def unit_of_role(role: str) -> str | None:
    """Return the unit whose process is called so; None where it is no driver."""
    return role.removeprefix(_DRIVER) if role.startswith(_DRIVER) else None


CONFIGURATIONS = ".yaml", ".yml"  # what a configuration's name ends in
