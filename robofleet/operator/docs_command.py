"""The command ``robofleet docs``: the site of all guides, which a wheel brings."""

from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from robofleet.core.refusal import RefusedError
from robofleet.operator.page.browser import open_page

SITE = Path(__file__).parents[1] / "site"


class _Quiet(SimpleHTTPRequestHandler):
    """Serves the site's files, and says nothing of it."""

    def log_message(self, *_: Any) -> None:
        pass


def docs() -> None:
    """Read and search all guides in your browser.

    No network is needed.

    $ robofleet docs

    Ctrl-C ends it.
    """
    if not (SITE / "index.html").is_file():
        build = f"in a clone: pip install -e '.[docs]', then python -m tools.docs --out {SITE}"
        raise RefusedError(f"the guides are not in this installation: a wheel brings them; {build}")
    # served: a browser that is confined, as Ubuntu's, opens no file in a hidden folder
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(SITE))) as server:
        address = f"http://127.0.0.1:{server.server_port}/"
        print(f"{address}   (Ctrl-C ends it)", flush=True)
        open_page(address)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
