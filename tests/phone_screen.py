"""A page in Chromium on a screen of a given width, for tests of what is seen on a phone."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

BROWSER = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)
QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
# A window is 500 pixels wide at least, a frame in it is not.
FRAME = """<!DOCTYPE html><title></title>
<iframe style="width: {width}px; height: 1400px; border: 0" srcdoc="{page}" onload="
  const inner = this.contentDocument;
  const heads = [...inner.querySelectorAll('th')].filter(cell => cell.textContent.includes('{head}'));
  document.title = JSON.stringify({{
    width: this.contentWindow.innerWidth,
    page: inner.documentElement.scrollWidth,
    cut: [...inner.querySelectorAll('body *')].filter(
      part => part.scrollWidth > part.clientWidth + 1 && getComputedStyle(part).overflowX == 'auto'
        && !this.contentWindow.getComputedStyle(part, '::before').content.includes('swipe')
    ).map(part => part.textContent.trim().slice(0, 40)),
    heads: heads.map(cell => cell.getBoundingClientRect().right),
  }});
"></iframe>"""


def measured(page: Path, width: int, folder: Path, head: str) -> dict:
    """Width of the screen and of the page, the right edge of every table's head with these words [px], and
    the beginnings of tables that are cut off without a word."""
    frame = folder / "frame.html"
    frame.write_text(FRAME.format(width=width, head=head, page=html.escape(page.read_text())))
    own = f"--user-data-dir={folder / 'browser'}"
    call = [BROWSER, *QUIET, "--window-size=1600,1500", own, "--dump-dom", frame.as_uri()]
    text = subprocess.run(call, capture_output=True, text=True, check=True, timeout=120).stdout
    return json.loads(html.unescape(re.search("<title>(.*)</title>", text)[1]))
