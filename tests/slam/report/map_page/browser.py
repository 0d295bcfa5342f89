"""Chromium without a window: scripts run in a page, and the times until a page is seen."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
_LAPTOP = "--window-size=1366,768"
_TIMER = """<script>
const tell = (name, time) => console.log(`TIME ${name} ${time}`);
new PerformanceObserver((list) => list.getEntries().forEach((entry) => tell(entry.name, entry.startTime)))
  .observe({ type: "paint", buffered: true });
addEventListener("load", async () => {
  await Promise.all([...document.images].map((image) => image.decode().catch(() => 0)));
  requestAnimationFrame(() => setTimeout(() => tell("shown", performance.now())));
});
</script>"""
"""Tells the paints of the page, and when the pictures of the map are decoded and drawn."""


@dataclass(frozen=True)
class PaintTimes:
    """Seconds from the start of the navigation."""

    first_paint_s: float
    """`PerformancePaintTiming`: anything is drawn."""
    contentful_s: float
    """`PerformancePaintTiming`: text or a picture is drawn."""
    shown_s: float
    """The map's pictures are drawn."""


def paint_times(path: Path) -> PaintTimes:
    """Open the page ``path`` once, in a profile without anything kept, and return what the browser tells."""
    timed = path.with_name("timed.html")
    timed.write_text(path.read_text(encoding="utf-8").replace("<head>", f"<head>{_TIMER}", 1), "utf-8")
    # Without a virtual clock, which stands still while the page works.
    said = _run(timed, _LAPTOP, "--enable-logging=stderr", "--timeout=4000", "--dump-dom").stderr
    found = {name: float(ms) / 1e3 for name, ms in re.findall(r"TIME (\S+) ([\d.]+)", said)}
    timed.unlink()
    return PaintTimes(found["first-paint"], found["first-contentful-paint"], found["shown"])


def _run(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert BROWSER is not None
    command = [
        BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        f"--user-data-dir={page.parent / 'profile'}", *options, page.as_uri(),
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)


def in_browser(path: Path, script: str, window_px: tuple[int, int] = (1200, 800)) -> dict:
    """Run ``script``, the body of a function that returns an object, in the page; return that object.

    ``window_px``: width and height of the window. The page's own errors fail the test.
    """
    tried = path.with_name("tried.html")
    listener = "<script>window.errors=[];addEventListener('error',e=>errors.push(e.message))</script>"
    runner = (
        "<script>addEventListener('load',()=>setTimeout(()=>{let found;"
        f"try{{found=(()=>{{{script}}})()}}catch(e){{errors.push(String(e))}}"
        "const out=document.createElement('pre');out.id='found';"
        "out.textContent=JSON.stringify({found,errors});document.body.append(out)},50))</script>"
    )
    text = path.read_text(encoding="utf-8").replace("<head>", f"<head>{listener}", 1)
    tried.write_text(text.replace("</body>", f"{runner}</body>"), encoding="utf-8")
    done = _run(tried, "--window-size={},{}".format(*window_px), "--virtual-time-budget=3000", "--dump-dom")
    (answer,) = re.findall(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    answer = json.loads(html.unescape(answer))
    assert answer["errors"] == []
    return answer["found"]
