"""A Chromium without a screen."""

import contextlib
import shutil

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
#: Nothing to the outside, software in place of a graphics card.
FLAGS = (
    "--no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-unsafe-swiftshader"
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium to look with: .ci/packages"
)


@contextlib.contextmanager
def chromium():
    """The browser; skipped without playwright."""
    reason = "playwright is not installed"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
        yield browser
        browser.close()


def assert_readable_at_400_px(*pages):
    """No page (HTML) is scrolled sideways; text and pictures are large enough."""
    sizes = (
        "[...document.querySelectorAll('body *')]"
        ".map(one => parseFloat(getComputedStyle(one).fontSize))"
    )
    with chromium() as started:
        shown = started.new_page(viewport={"width": 400, "height": 800})
        for page in pages:
            shown.set_content(page)
            assert shown.evaluate("document.documentElement.scrollWidth") <= 400
            assert min(shown.evaluate(sizes)) >= 12.0
            assert min(shown.evaluate("[...document.images].map(one => one.clientWidth)")) >= 360
