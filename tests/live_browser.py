"""Debian's Chromium without a screen, drawing in software, for tests of the live page.

Screenshots go to the folder that SWARMSCAN_ARTEFACTS names, else to the test's own.
"""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect, sync_playwright

CHROMIUM = shutil.which("chromium")
SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE_MS = 240_000.0
NEEDS_BROWSER = pytest.mark.skipif(CHROMIUM is None, reason="no browser; run: sudo apt-get install -y chromium")


@contextmanager
def tab_at(port: int) -> Iterator[Page]:
    """A tab at a page that is being started."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        _open_when_served(tab, port)
        yield tab
        browser.close()


def keep(page: Page, tmp_path: Path, name: str) -> None:
    """A screenshot."""
    folder = Path(os.environ.get("SWARMSCAN_ARTEFACTS", tmp_path))
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=folder / f"live_{name}.png")


def _open_when_served(tab: Page, port: int) -> None:
    """Ask again until somebody listens."""
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        tab.wait_for_timeout(100)
    tab.goto(f"http://127.0.0.1:{port}")
