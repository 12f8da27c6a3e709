"""Open pages in a headless browser, if one is installed."""

import html
import json
import re
import shutil
import subprocess

import pytest

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
# Errors of a page and failed requests. Performance advice is ignored: tests that read pixels back cause it.
TROUBLE = re.compile(r"CONSOLE(?!.*willReadFrequently).*|net::ERR_\w+|Uncaught.*")


def opened(page, folder, script="return {};", width=1280):
    """Open a page in a browser and run the body of an async function when the page is ready.

    Returns the result of the function. Fails if anything was written to the console. Skips if there is no browser.
    """
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip(f"no browser here: none of {', '.join(PROGRAMS)} is on the path")
    driver = """<script>(async () => {
    const pause = () => new Promise((go) => setTimeout(go, 20));
    for (let n = 0; n < 400 && document.body.dataset.ready !== "yes"; n++) await pause();
    for (const image of document.images) if (!image.naturalWidth) console.error("cannot be shown: " + image.src);
    const found = await (async () => { %s })();
    const result = document.createElement("pre");
    result.id = "result"; result.textContent = JSON.stringify(found); document.body.append(result);
    })();</script></body>"""
    path = folder / "opened.html"
    path.write_text(page.replace("</body>", driver % script), encoding="utf-8")
    process = subprocess.run(
        [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={folder / 'browser'}",
            f"--window-size={width},1000",
            "--virtual-time-budget=20000",
            "--enable-logging=stderr",
            "--dump-dom",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert not TROUBLE.findall(process.stderr), process.stderr[-2000:]
    found = re.search(r'<pre id="result">(.*?)</pre>', process.stdout, re.DOTALL)
    assert found, process.stdout[-2000:] + process.stderr[-2000:]
    return json.loads(html.unescape(found[1]))


def outside_resources(page):
    """Addresses that a page would load from elsewhere; links to click do not count."""
    loading = (
        r"""(?:src|srcset|poster|data)\s*=\s*["'](?!data:|\#)([^"']+)|<link[^>]+href\s*=\s*["'](?!data:)([^"']+)"""
    )
    loading += (
        r"""|url\(\s*["']?(?!data:)([^"')]+)|@import\s+["']([^"']+)|\b(?:fetch|import|importScripts)\(\s*["']([^"']+)"""
    )
    return ["".join(parts) for parts in re.findall(loading, page)]
