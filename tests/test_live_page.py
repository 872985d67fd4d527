"""The live page in a real browser, against a real flight."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.live_browser import NEEDS_BROWSER, keep, tab_at
from tests.live_world import flying, free_port

pytestmark = [pytest.mark.loopback, pytest.mark.xdist_group("live"), NEEDS_BROWSER]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A browser at the page of a flight that waits for Start."""
    port = free_port()
    flight, _ = flying(tmp_path, "clock.speed=1.0", "explore.max_views=40",
                       live=("--live", "--port", str(port), "--wait"))
    try:
        with tab_at(port) as tab:
            yield tab
    finally:
        flight.stop()


def says(page: Page, vehicle_id: int, what: str) -> None:
    expect(page.locator(f'[data-vehicle="{vehicle_id}"]')).to_have_text(what)


def done(page: Page, what: str) -> None:
    expect(page.locator("#answer")).to_contain_text(what)


def click_the_model(page: Page) -> None:
    """In the middle of the scene, and where that was empty beside it, until its pictures are shown."""
    box = page.locator("canvas").first.bounding_box()
    shown = page.get_by_text(re.compile(r"\d+ pictures show \("))
    assert box is not None
    for aside, down in ((0.5, 0.5), (0.5, 0.55), (0.5, 0.45), (0.45, 0.5), (0.55, 0.5)):
        page.mouse.click(box["x"] + aside * box["width"], box["y"] + down * box["height"])
        with suppress(AssertionError):
            expect(shown).to_be_visible(timeout=20_000)
            return
    expect(shown).to_be_visible()


def test_an_operator_starts_pauses_resumes_marks_a_region_and_calls_everybody_home(page: Page, tmp_path: Path) -> None:
    expect(page.locator("#phase")).to_have_text("Waiting for Start")
    page.get_by_role("button", name="Start").click()
    says(page, 1, "flying")
    canvas = page.locator("canvas").first
    before = canvas.screenshot()
    assert any(canvas.screenshot() != before for _ in range(100)), "vehicles move in the picture"
    expect(page.get_by_text(re.compile(r"^([4-9]\d|100)%$"))).to_be_visible()

    page.get_by_role("button", name="Pause all").click()
    done(page, "pause all. vehicle 1 accepted; vehicle 2 accepted")
    says(page, 1, "paused")
    expect(page.get_by_text("Vehicle 1 waits in the air for you to resume it.")).to_be_visible()
    keep(page, tmp_path, "paused")
    assert page.context.browser is not None
    second = page.context.browser.new_page()
    second.goto(page.url)
    says(second, 2, "paused")
    second.close()

    click_the_model(page)
    keep(page, tmp_path, "pictures")
    page.get_by_role("button", name="Close").click()

    page.get_by_role("button", name="Resume all").click()
    done(page, "resume all. vehicle 1 accepted; vehicle 2 accepted")
    says(page, 1, "flying")

    page.get_by_role("button", name="||", exact=True).nth(1).click()
    done(page, "pause vehicle 2. vehicle 2 accepted")
    page.get_by_role("button", name="▶", exact=True).nth(1).click()
    done(page, "resume vehicle 2. vehicle 2 accepted")

    page.get_by_role("button", name="Mark important").click()
    page.get_by_role("button", name="Apply: important").click()
    done(page, "mark a region as important")
    expect(page.get_by_role("button", name="Clear region")).to_be_visible()
    keep(page, tmp_path, "region")

    page.get_by_role("button", name="All home").click()
    page.get_by_role("button", name="Yes, all home").click()
    done(page, "send home all. vehicle 1 accepted; vehicle 2 accepted")
    says(page, 2, "waits on its pad")
    keep(page, tmp_path, "home")
