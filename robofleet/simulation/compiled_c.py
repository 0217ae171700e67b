"""What C compilers make for this user: made once, found again by its content.

It is code that runs. So the folder is the user's alone; one that others reach is refused.
"""

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from robofleet.bus.private_folder import check_private
from robofleet.core.folders import kernels_folder


def compiled(name: str, content: Sequence[bytes], make: Callable[[Path], None]) -> Path:
    """Return a folder of what ``make`` compiles into the folder that it is given.

    Args:
        name: What it is, as part of the folder's name.
        content: All that decides the result: sources and flags.
        make: Called where nobody has compiled this content. What it raises leaves nothing behind.

    Raises:
        PlaceError: Others can reach the folder of all that is compiled.
    """
    root = kernels_folder().with_name("compiled")
    root.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_private(root, "XDG_CACHE_HOME")
    digest = hashlib.sha256(b"\0".join(content)).hexdigest()[:16]
    folder = root / f"{name}-{digest}"
    if not folder.is_dir():
        with tempfile.TemporaryDirectory(dir=root) as making:
            made = Path(making) / name
            made.mkdir()
            make(made)
            with suppress(OSError):  # another process was faster
                made.rename(folder)
    return folder
