"""Every button of the live page in a real browser, each before a mission that writes down what it is asked to do."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from playwright.sync_api import Page, expect
from viser.transforms import SO3

from ground_station.live.page import FRAME_S, LivePage
from ground_station.live.synthetic import SyntheticMission
from missions import live
from missions.frames import Array
from missions.live import LiveRegion, LiveState, OperatorAnswer
from missions.messages import Vector
from tests.live_browser import NEEDS_BROWSER, keep, tab_at

pytestmark = [pytest.mark.xdist_group("loopback"), NEEDS_BROWSER]


class Asked(SyntheticMission):
    """Keeps what it was asked for, and shows marked regions as a ground station would."""

    def __init__(self, folder: Path) -> None:
        self.actions: list[live.AnyAction] = []
        self.regions: list[LiveRegion] = []
        super().__init__(2, folder)

    def do(self, action: live.AnyAction) -> OperatorAnswer:
        self.actions.append(action)
        if isinstance(action, live.MarkRegion):
            self.regions = [LiveRegion(region_id=7, kind=action.kind, lower_enu_m=action.lower_enu_m,
                                       upper_enu_m=action.upper_enu_m)]
        elif isinstance(action, live.ClearRegion):
            self.regions = []
        return super().do(action)

    def _state(self) -> LiveState:
        return structs.replace(super()._state(), regions=self.regions)


@contextmanager
def served(mission: Asked) -> Iterator[LivePage]:
    page, over = LivePage(mission, 0), threading.Event()

    def draw() -> None:
        while not over.wait(FRAME_S):
            mission.step()
            page.draw()

    thread = threading.Thread(target=draw)
    thread.start()
    try:
        yield page
    finally:
        over.set()
        thread.join()
        page.close()


def press(page: Page, name: str, nth: int = 0) -> None:
    page.get_by_role("button", name=name, exact=True).nth(nth).click()


def done(page: Page, what: str) -> None:
    expect(page.locator("#answer")).to_contain_text(what)


def test_every_button_asks_for_what_it_says_and_the_dangerous_ones_ask_once(tmp_path: Path) -> None:
    mission = Asked(tmp_path)
    with served(mission) as page_of, tab_at(page_of.port) as page:
        press(page, "⌂", 1)
        done(page, "Home")
        for name in ("Land here", "Drop", "Add"):
            press(page, "…", 0)
            if name == "Land here":
                expect(page.get_by_text("it flies no more")).to_be_visible()
                keep(page, tmp_path, "more")
            press(page, name)
            done(page, name.split()[0])
        press(page, "Mark forbidden")
        press(page, "Apply: forbidden")
        done(page, "MarkRegion")
        page.get_by_role("textbox", name="Marked").or_(page.get_by_label("Marked")).first.click()
        page.get_by_role("option", name="7 forbidden").click()
        press(page, "Clear region")
        done(page, "ClearRegion")
        press(page, "Move fence corners")
        press(page, "Apply the fence")
        done(page, "MoveFence")
        page.get_by_text("Goal", exact=True).click()
        press(page, "Explore up to this")
        done(page, "SetGoal")
        for answer in ("No", "Yes, abort mission"):
            press(page, "Abort mission")
            press(page, answer)
        done(page, "Abort")
    fence, marked = mission._state(), mission.actions.pop(4)
    assert isinstance(marked, live.MarkRegion)
    assert marked.kind == "forbidden"
    assert mission.actions == [
        live.Home(vehicle_id=2), live.Land(vehicle_id=1), live.Drop(vehicle_id=1), live.Add(vehicle_id=1),
        live.ClearRegion(region_id=7),
        live.MoveFence(lower_enu_m=fence.fence_lower_enu_m, upper_enu_m=fence.fence_upper_enu_m),
        live.SetGoal(coverage=0.95), live.Abort()]


def test_a_corner_of_the_fence_is_in_view_and_goes_where_it_is_dragged(tmp_path: Path) -> None:
    mission = Asked(tmp_path)
    with served(mission) as page_of, tab_at(page_of.port) as page:
        press(page, "Move fence corners")
        page.get_by_role("button", name="Apply the fence").wait_for()
        x, y, up = mission._state().fence_upper_enu_m
        moved = drag(page, page_of, np.array((x, y, up + 4.0)), np.array((x, y, up + 9.0)))
        keep(page, tmp_path, "fence")
        press(page, "Apply the fence")
        press(page, "Yes, move the fence out")
        done(page, "MoveFence")
    asked = mission.actions[-1]
    assert isinstance(asked, live.MoveFence)
    assert asked.upper_enu_m == moved
    assert asked.lower_enu_m == mission._state().fence_lower_enu_m
    assert moved[:2] == (x, y)
    assert moved[2] > up + 1.0


def drag(page: Page, page_of: LivePage, here_enu_m: Array, there_enu_m: Array) -> Vector:
    """Pull the handle under a place until the box has followed; its upper corner then."""
    controls = page_of._controls
    assert controls is not None
    while controls._tool is None:
        page.wait_for_timeout(100)
    before = controls._tool.box
    while controls._tool.box == before:  # a browser that draws slowly has not drawn the handle yet
        page.mouse.move(*on_screen(page, page_of, here_enu_m))
        page.mouse.down()
        page.mouse.move(*on_screen(page, page_of, there_enu_m), steps=5)
        page.mouse.up()
        for _ in range(100):
            if controls._tool.box != before:
                break
            page.wait_for_timeout(100)
    while (now := controls._tool.box) != before:
        before = now
        page.wait_for_timeout(2000)
    return now[1]


def on_screen(page: Page, page_of: LivePage, place_enu_m: Array) -> tuple[float, float]:
    """Where the only browser shows a place."""
    (client,) = page_of._server.get_clients().values()
    canvas = page.locator("canvas").first.bounding_box()
    assert canvas is not None
    x, y, ahead = SO3(np.array(client.camera.wxyz)).inverse().as_matrix() @ (place_enu_m - client.camera.position)
    focal_px = 0.5 * canvas["height"] / np.tan(0.5 * client.camera.fov)
    return (float(canvas["x"] + 0.5 * canvas["width"] + focal_px * x / ahead),
            float(canvas["y"] + 0.5 * canvas["height"] + focal_px * y / ahead))
