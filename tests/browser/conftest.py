"""A headless Chromium, and pages in it that may not reach the network: `make test-browser`.

    def test_something(open_page, tmp_path):
        page = open_page(tmp_path / "page.html")     # playwright's Page, file:// of course
        assert page.evaluate("1 + 1") == 2

What a page logs as an error, throws, or asks the network for fails the test that opened it, but
for what `open_page.expected(words)` has announced.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
# WebGL 2 without a GPU: Mesa's software renderer, which the previews use too; and where Chromium
# does not find it, its own, which is slower.
GRAPHICS = (
    ("--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist"),
    ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
HAS_WEBGL = "Boolean(document.createElement('canvas').getContext('webgl2'))"
DESKTOP = {"width": 1280, "height": 800}
PHONE = {"width": 375, "height": 740}
PICTURES = Path(__file__).parents[2] / "build" / "browser"


@pytest.fixture(scope="session")
def chromium():
    """A running headless browser, as playwright has it; tests are skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="make test-browser installs it")
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("no Chromium: apt-get install chromium, or name one in CHROMIUM")
    with playwright.sync_playwright() as started:
        for graphics in GRAPHICS:
            browser = started.chromium.launch(executable_path=program, args=list(graphics))
            page = browser.new_page()
            if page.evaluate(HAS_WEBGL):
                page.close()
                yield browser
                browser.close()
                return
            browser.close()
        pytest.fail("Chromium has no WebGL 2, not even in software")


@pytest.fixture
def open_page(chromium):
    """open_page(path, size=DESKTOP, after="", before="", **context) -> a Page that loaded a file.

    size     of the window in CSS pixels
    after    what follows the file's name: "#model=sphere"
    before   a script that runs before the page's own
    context  as playwright's `Browser.new_context` takes it, as color_scheme="dark"
    """
    contexts, wrong, expected = [], [], []

    def refuse(route):
        wrong.append(f"asked for {route.request.url}")
        route.abort()

    def open_page(path: Path, size=DESKTOP, after="", before="", **context):
        contexts.append(chromium.new_context(viewport=size, accept_downloads=True, **context))
        page = contexts[-1].new_page()
        page.add_init_script(before)
        page.route(lambda url: not url.startswith(("file:", "blob:", "data:")), refuse)
        page.on("request", lambda request: asked(request, path))
        page.on("console", lambda said: said.type == "error" and wrong.append(said.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(path.resolve().as_uri() + after)
        return page

    def asked(request, path):
        """Of local files, too, only the page itself may be asked for."""
        url = request.url.split("#")[0]
        if url.startswith("file:") and url != path.resolve().as_uri():
            wrong.append(f"asked for {url}")

    open_page.expected = expected.append
    yield open_page
    for context in contexts:
        context.close()
    assert [said for said in wrong if not any(words in said for words in expected)] == []


@pytest.fixture
def picture():
    """picture(page, name): a screenshot in build/browser, to be looked at."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    return lambda page, name: page.screenshot(path=PICTURES / f"{name}.png")
