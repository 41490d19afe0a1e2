"""The report in a real browser: no complaint on its console, every figure drawn, both schemes.

Chromium is taken from DMPTM_CHROMIUM or the path; without one this is skipped.
"""

import json
import os
import re
import shutil
import subprocess

import pytest

from .test_html import rendered

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
BROWSER = os.environ.get("DMPTM_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium; set DMPTM_CHROMIUM")

# Appended to a copy, whose policy allows it: what the browser made of the page.
LOOK = """<script>
window.addEventListener("load", () => {
  const style = getComputedStyle(document.body);
  document.title = JSON.stringify({
    images: [...document.images].map(i => i.complete ? i.naturalWidth : 0),
    lost: [...document.links].filter(a => !document.getElementById(a.hash.slice(1))).length,
    wide: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    background: style.backgroundColor, text: style.color,
    reached: [...document.querySelectorAll("a, summary, [tabindex]")].every(e => e.tabIndex >= 0),
  });
});
</script>"""


def browse(tmp_path, page, *options):
    file = tmp_path / "report.html"
    file.write_text(page, encoding="utf-8")
    return subprocess.run(
        [
            *(BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-extensions"),
            *("--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}"),
            *("--virtual-time-budget=3000", *options, file.as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=240,
        check=True,
    )


@pytest.mark.parametrize(("scheme", "option"), [("light", 1), ("dark", 0)])
def test_everything_is_drawn(tmp_path, scheme, option):
    page = re.sub(r"<meta http-equiv[^>]*>", "", rendered("explained"))
    page = page.replace("</body>", LOOK + "</body>")
    setting = f"--blink-settings=preferredColorScheme={option}"
    done = browse(tmp_path, page, "--window-size=1000,800", setting, "--dump-dom")
    seen = json.loads(re.search(r"<title>(.*?)</title>", done.stdout)[1])
    assert len(seen["images"]) >= 5
    assert all(width > 0 for width in seen["images"])
    assert seen["lost"] == 0
    assert seen["wide"] <= 0
    assert seen["reached"]
    level = [sum(map(int, re.findall(r"\d+", seen[key])[:3])) for key in ("background", "text")]
    assert (level[0] > level[1]) is (scheme == "light")


def test_nothing_on_the_console_and_it_prints(tmp_path):
    paper = tmp_path / "report.pdf"
    done = browse(tmp_path, rendered("explained"), f"--print-to-pdf={paper}")
    assert "CONSOLE" not in done.stderr
    assert paper.read_bytes().startswith(b"%PDF")
