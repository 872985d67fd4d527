"""The live page: a model of a mission, under way or played again, drawn with viser.

viser was chosen over rerun by trying both in headless Chromium with software rendering: with the same cloud it drew
four times as many frames, and it has buttons, dialogues and draggable handles that call back; rerun only shows.
"""

from __future__ import annotations

import logging
import time
from contextlib import AbstractContextManager, redirect_stdout
from io import StringIO
from typing import Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from ground_station.live import panel
from ground_station.live.colours import css, of_vehicle
from ground_station.live.controls import Controls
from ground_station.live.map_in_scene import COLOURS, MapInScene, Surroundings
from ground_station.live.model import LiveModel
from ground_station.live.vehicles_in_scene import VehicleInScene, thumbnail
from missions import live
from missions.frames import Array
from missions.live import LivePicture, LiveSite, LiveState, OperatorAnswer
from missions.messages import vector

FRAME_S = 1.0 / 15.0
"""Vehicles move so often; a browser draws when something has moved."""
UPDATE_S = 0.25
"""Updates come about so often; vehicles glide from one to the next."""
MAP_S = 2.0
"""The surface is drawn anew at most so often: a browser keeps some 5 kB of every glTF node that is replaced."""
MOST_PICTURES = 6
PICTURE_PX = 420
VEHICLE_SHARE = 0.036
"""Vehicles are drawn this large, of the object's diagonal, so that they are seen from afar."""
BOX_AROUND_M = 1.0
"""A region that is to be drawn begins as half of the object's box and so much around it."""
PANEL_PX, OPERATE_PX = 310, 280


class Watched(Protocol):
    """A mission that is under way, or one that is played again."""

    @property
    def over(self) -> bool:
        """Whether nothing more will come."""

    def reading(self) -> AbstractContextManager[LiveModel]:
        """All that is known, which does not change meanwhile."""

    def do(self, action: live.AnyAction) -> OperatorAnswer:
        """Ask for an action and wait for the answer."""


class LivePage:
    """Serves until the mission is over. Every browser sees the same; each has a camera of its own."""

    def __init__(self, mission: Watched, port: int) -> None:
        self._mission = mission
        self._server = _quiet_server(port)
        gui, scene = self._server.gui, self._server.scene
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_layout="floating",
                            brand_color=(90, 169, 245))
        gui.set_panel_label("Operate")
        scene.set_up_direction("+z")
        # Nothing here is lit. viser's own lights would cost a second at the start, behind which it hides the scene, and
        # shadows in every frame. A background of our own would be one more shader to compile before anything is seen.
        scene.configure_environment_map(None)
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        left = gui.add_panel()
        with left.add_tab("Mission"):
            self._head, self._alarms = gui.add_html(""), gui.add_html("")
            self._cards = gui.add_html("")
            self._legend = gui.add_html(panel.legend_html(COLOURS[0]))
        left.dock_left()
        left.set_width(PANEL_PX)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(OPERATE_PX)
        self._map = MapInScene(scene)
        self._vehicles: dict[int, VehicleInScene] = {}
        self._surroundings: Surroundings | None = None
        self._controls: Controls | None = None
        self._seq, self._map_key, self._map_at = -1, (-1, -1), 0.0
        self._took_at = 0.0
        self._looks_new = False
        scene.on_click()(self._clicked)

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.get_port()

    def serve(self) -> None:
        """Draw until the mission is over."""
        while not self._mission.over:
            self.draw()
            time.sleep(FRAME_S)
        self.draw()

    def draw(self) -> None:
        """Show what is new, and move everybody on."""
        with self._mission.reading() as model:
            site, state, seq = model.site, model.state, model.seq
            if site is None or state is None:
                return
            if seq != self._seq:
                self._take(site, state, model)
            self._seq = seq
            solid = self._new_map(model)
            if solid is not None:
                self._map.take(solid, model)
        if self._looks_new:
            self._looks_new = False
            self._look()
        share = (time.monotonic() - self._took_at) / UPDATE_S
        with self._server.atomic():
            for vehicle in self._vehicles.values():
                vehicle.move(share)

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _take(self, site: LiveSite, state: LiveState, model: LiveModel) -> None:
        self._took_at = time.monotonic()
        if self._surroundings is None or self._controls is None:
            self._begin(site, state)
        assert self._surroundings is not None
        assert self._controls is not None
        with self._server.atomic():
            self._head.content = panel.mission_html(site, state, model.curve)
            self._show(self._alarms, panel.alarms_html(state.alarms))
            self._show(self._cards, panel.vehicles_html(site, state.vehicles))
            self._surroundings.take(state)
            self._controls.take(state)
            for vehicle in state.vehicles:
                k = vehicle.vehicle_id
                self._vehicles[k].take(vehicle, model.plans.get(k), model.trails[k])
        for picture in model.latest_pictures():
            self._vehicles[picture.vehicle_id].show_picture(picture)

    def _begin(self, site: LiveSite, state: LiveState) -> None:
        """The first state: what stands there, who flies, where to look from."""
        scene = self._server.scene
        low, high = np.array(site.object_lower_enu_m), np.array(site.object_upper_enu_m)
        middle, span = 0.5 * (low + high), float(np.linalg.norm(high - low))
        around = float(np.linalg.norm(np.subtract(site.fence_upper_enu_m, site.fence_lower_enu_m)[:2]))
        camera = self._server.initial_camera
        camera.position = tuple(middle + max(span, 0.5 * around) * np.array([0.42, -0.8, 0.4]))
        camera.look_at = tuple(middle - np.array([0.0, 0.05 * around, 0.1 * span]))
        self._surroundings = Surroundings(scene, site)
        self._vehicles = {v.vehicle_id: VehicleInScene(scene, v, max(1.0, VEHICLE_SHARE * span))
                          for v in state.vehicles}
        half = np.where(np.arange(3) == np.argmax(high - low), middle, low - BOX_AROUND_M)
        self._controls = Controls(self._server, self._mission, site, state,
                                  (vector(half), vector(high + BOX_AROUND_M)), self._wants_new_look)

    def _new_map(self, model: LiveModel) -> NDArray[np.int64] | None:
        """(n, 3) the solid voxels, when they or the pictures have changed and it is time."""
        key = model.map_version, len(model.pictures)
        if key == self._map_key or time.monotonic() - self._map_at < MAP_S:
            return None
        self._map_key, self._map_at = key, time.monotonic()
        return np.array(sorted(model.solid), dtype=np.int64).reshape(-1, 3)

    def _wants_new_look(self) -> None:
        self._looks_new = True

    def _look(self) -> None:
        assert self._controls is not None
        self._map.detail, self._map.colour = self._controls.detail.value, self._controls.colour.value
        self._map.draw()
        self._legend.content = panel.legend_html(self._map.colour)
        for vehicle in self._vehicles.values():
            vehicle.show_trail(self._controls.trails.value)
            vehicle.show_tour(self._controls.tours.value)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        """A point of the model: the pictures that show it."""
        if event.ray_origin is None or event.ray_direction is None:
            return
        hit = self._map.hit(np.array(event.ray_origin), np.array(event.ray_direction))
        if hit is not None:
            self._show_pictures(hit, self._map.seen_by(hit), event.client)

    def _show_pictures(self, point_enu_m: Array, seen_by: list[LivePicture],
                       client: viser.ClientHandle) -> None:
        gui = client.gui
        east, north, up = point_enu_m
        with gui.add_modal(f"{len(seen_by)} pictures show ({east:.1f}, {north:.1f}, {up:.1f}) m") as modal:
            for picture in seen_by[:MOST_PICTURES]:
                image = thumbnail(picture, PICTURE_PX)
                if image is not None:
                    gui.add_html(f'<div style="border-left:4px solid {css(of_vehicle(picture.vehicle_id))};'
                                 f'padding-left:8px">view {picture.view_id}, vehicle {picture.vehicle_id}, '
                                 f"{picture.phase}, {picture.t_s:.0f} s</div>")
                    gui.add_image(image, format="jpeg")
            gui.add_button("Close").on_click(lambda _: modal.close())

    @staticmethod
    def _show(block: viser.GuiHtmlHandle, content: str) -> None:
        if block.content != content:
            block.content = content


def _quiet_server(port: int) -> viser.ViserServer:
    """On loopback. viser prints a banner to stdout, where commands print their results; websockets logs a page of text
    for everybody who only knocks."""
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    with redirect_stdout(StringIO()):
        return viser.ViserServer(host="127.0.0.1", port=port, label="swarmscan", verbose=False)
