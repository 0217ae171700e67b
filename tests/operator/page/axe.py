"""What axe finds on a page that a browser shows (axe-core, from the package axe-core-python)."""

from importlib.resources import files
from typing import Any

from selenium.webdriver import Chrome

_SCRIPT = files("axe_core_python").joinpath("axe.min.js").read_text()
_WITHIN_S = 60  # on a busy machine
_RUN = """
const [only, done] = arguments;
for (const plot of document.querySelectorAll("svg[role=img]")) plot.replaceChildren();
const options = {resultTypes: ["violations"], ...(only && {runOnly: {type: "rule", values: only}})};
axe.run(document, options).then(done, (error) => done(`${error}`));
"""


def violations(browser: Chrome, *only: str) -> list[str]:
    """Return a line for every violation of any of axe's rules, those of good practice too; or of some rules alone.

    A plot is one picture with one name. What it is drawn of is taken out: axe would look at each of its points.
    """
    browser.set_script_timeout(_WITHIN_S)
    if not browser.execute_script("return typeof axe === 'object'"):
        browser.execute_script(_SCRIPT)
    found: Any = browser.execute_async_script(_RUN, only or None)
    assert isinstance(found, dict), found
    assert found["testEngine"]["name"] == "axe-core"
    return [
        f"{rule['id']}: {node['target']}: {node['failureSummary']}"
        for rule in found["violations"]
        for node in rule["nodes"]
    ]
