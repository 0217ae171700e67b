"""Takes the README's picture of the operator's page: the platoon in real time, some seconds after its start.

python -m tools.measure.page_picture [OUT.jpg] [SECONDS]
"""

import base64
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from selenium.webdriver import Chrome

from tests.operator.page.browser import chromium
from tests.runs.realrun import wait

ROOT = Path(__file__).resolve().parents[2]
SIZE = {"width": 1440, "height": 960, "deviceScaleFactor": 1.5, "mobile": False}
QUALITY = 82
SHORT = "document.getElementById('config-name').textContent = 'runs/platoon/config.yaml'"  # not of a temporary folder
STARTED_WITHIN_S = 300.0  # kernels may be compiled first


def reached_s(browser: Chrome) -> float:
    """Return the time of the run that the page shows."""
    return float(browser.execute_script("return window.robofleet?.state.t_s ?? 0"))


def main() -> None:
    """Run, look, write."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / ".github" / "page.jpg"
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
    command = "run", str(ROOT / "configs" / "platoon.yaml"), "--web", "--no-browser", "--out", "runs/platoon"
    with tempfile.TemporaryDirectory() as folder, chromium() as browser, (Path(folder) / "output").open("w+") as output:
        run = subprocess.Popen([sys.executable, "-m", "robofleet", *command], cwd=folder, stdout=output, stderr=output)
        try:
            text = Path(output.name).read_text
            assert wait(lambda: "http://" in text() or run.poll() is not None, STARTED_WITHIN_S), text()
            browser.get(next(word for word in text().split() if word.startswith("http://")))
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SIZE)
            browser.find_element("id", "camera-toggle").click()
            assert wait(lambda: reached_s(browser) >= seconds or run.poll() is not None, STARTED_WITHIN_S), text()
            browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
            browser.execute_script(SHORT)
            picture = browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "jpeg", "quality": QUALITY})
        finally:
            run.send_signal(signal.SIGINT)
            run.wait()
    out.write_bytes(base64.b64decode(picture["data"]))


if __name__ == "__main__":
    main()
