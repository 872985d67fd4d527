"""The right side of the live page: everything that an operator can do. What is dangerous asks once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np
import viser

from ground_station.live.box_tool import BoxTool
from ground_station.live.colours import FENCE, FORBIDDEN, IMPORTANT
from ground_station.live.framing import step_back
from ground_station.live.map_in_scene import COLOURS, DETAIL
from ground_station.live.panel import answer_html, speed_words
from missions import live
from missions.errors import SwarmscanError
from missions.live import LivePlaying, LiveSite, LiveState, OperatorAnswer
from missions.messages import Vector

CLOSE_S = 10.0
SAME_M = 0.02
SPEEDS = (1.0, 2.0, 4.0, 8.0, 16.0)
FENCE_OUT = ("Vehicles may then fly beyond the mission's own fence. Is that space free of people, wires and other "
             "aircraft? They still fly only where pictures have shown it to be free.")


class Obeys(Protocol):
    """Carries out actions: a mission under way."""

    def do(self, action: live.AnyAction) -> OperatorAnswer:
        """The answer of all who were asked."""


class Controls:
    """Buttons, and the box that is being drawn."""

    def __init__(self, server: viser.ViserServer, mission: Obeys, site: LiveSite, state: LiveState,
                 box_m: tuple[Vector, Vector], look: Callable[[], None]) -> None:
        """look: called when somebody changes how the scene is to look. box_m: where a new region begins."""
        self._server, self._gui, self._mission, self._box_m = server, server.gui, mission, box_m
        self._site, self._state = site, state
        self._tool: BoxTool | None = None
        self._answer = self._gui.add_html("")
        if state.playing is not None:
            self._player(state.playing)
        else:
            self._operating(state)
        with self._gui.add_folder("View", expand_by_default=False):
            self.detail = self._gui.add_dropdown("Detail", tuple(DETAIL), initial_value="normal")
            self.colour = self._gui.add_dropdown("Colour", COLOURS, initial_value=COLOURS[0])
            self.trails = self._gui.add_checkbox("Trails", True)
            self.tours = self._gui.add_checkbox("Tours", True)
        for control in (self.detail, self.colour, self.trails, self.tours):
            control.on_update(lambda _: look())

    def take(self, state: LiveState) -> None:
        """A newer state."""
        self._state = state
        if state.playing is not None:
            self._play.visible, self._hold.visible = state.playing.paused, not state.playing.paused
            return
        self._start.visible = not state.started
        regions = tuple(f"{r.region_id} {r.kind}" for r in state.regions)
        if regions != self._regions.options[1:]:
            self._regions.options = ("none", *regions)
        self._regions.visible = self._forget.visible = bool(regions)

    def _player(self, playing: LivePlaying) -> None:
        """A recording can be held and played at any speed, and nothing else."""
        self._play = self._button("Play", lambda: live.Resume(), "green", viser.Icon.PLAYER_PLAY)
        self._hold = self._button("Pause", lambda: live.Pause(), "yellow", viser.Icon.PLAYER_PAUSE)
        self._play.visible, self._hold.visible = playing.paused, not playing.paused
        speeds = {speed_words(s): s for s in sorted({*SPEEDS, playing.speed} - {0.0})} | {speed_words(0.0): 0.0}
        speed = self._gui.add_dropdown("Speed", tuple(speeds), initial_value=speed_words(playing.speed))

        @speed.on_update
        def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
            self._do(live.SetSpeed(speed=speeds[speed.value]), event.client)

    def _operating(self, state: LiveState) -> None:
        self._all_buttons()
        with self._gui.add_folder("Vehicles"):
            for vehicle in state.vehicles:
                self._vehicle_row(vehicle.vehicle_id)
        with self._gui.add_folder("Regions and fence"):
            self._region_buttons()
        with self._gui.add_folder("Goal", expand_by_default=False):
            self._goal_slider()

    def _all_buttons(self) -> None:
        self._start = self._button("Start", lambda: live.Start(), "green", viser.Icon.PLAYER_PLAY)
        self._start.visible = not self._state.started
        self._button("Pause all", lambda: live.Pause(), "yellow", viser.Icon.PLAYER_PAUSE)
        self._button("Resume all", lambda: live.Resume(), "blue", viser.Icon.PLAYER_TRACK_NEXT)
        self._button("All home", lambda: live.Home(), "gray", viser.Icon.HOME,
                     ask="All vehicles return, land on their pads and wait there until they are resumed.")
        self._button("Abort mission", lambda: live.Abort(), "red", viser.Icon.ALERT_OCTAGON,
                     ask="All vehicles return and the mission is over. What was taken is kept.")

    def _vehicle_row(self, k: int) -> None:
        row = self._gui.add_button_group(str(k), ("||", "▶", "⌂", "…"), hint="pause, resume, send home, more")
        actions: dict[str, live.AnyAction] = {"||": live.Pause(vehicle_id=k), "▶": live.Resume(vehicle_id=k),
                                              "⌂": live.Home(vehicle_id=k)}

        @row.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            if event.target.value in actions:
                self._do(actions[event.target.value], event.client)
            else:
                self._more(k)

    def _more(self, k: int) -> None:
        """What is done rarely to one vehicle; two of them are dangerous, so that this dialogue is the asking."""
        with self._dialogue(f"Vehicle {k}") as close:
            self._gui.add_markdown("**Land here** goes straight down, or home where what is below is not known to "
                                   "be free; it flies no more.")
            self._button("Land here", lambda: live.Land(vehicle_id=k), "red", then=close)
            self._gui.add_markdown("**Drop** brings it home and gives its views to the others.")
            self._button("Drop", lambda: live.Drop(vehicle_id=k), "orange", then=close)
            self._gui.add_markdown("**Add** lets a vehicle of the reserve, or a dropped one, take part.")
            self._button("Add", lambda: live.Add(vehicle_id=k), "green", then=close)

    def _region_buttons(self) -> None:
        for label, kind, icon in (("Mark important", "important", viser.Icon.STAR),
                                  ("Mark forbidden", "forbidden", viser.Icon.BAN),
                                  ("Move fence corners", "fence", viser.Icon.FENCE)):
            button = self._gui.add_button(label, icon=icon)
            button.on_click(lambda event, kind=kind: self._draw(kind, event.client))  # type: ignore[misc]
        self._apply = self._button("Apply the box", lambda: None, "green", viser.Icon.CHECK)
        self._cancel = self._button("Cancel", self._put_away, "gray")
        self._apply.visible = self._cancel.visible = False
        self._regions = self._gui.add_dropdown("Marked", ("none",), visible=False)
        self._forget = self._button("Clear region", self._cleared, "gray")
        self._forget.visible = False
        self._apply.on_click(self._applied)

    def _draw(self, kind: str, client: viser.ClientHandle | None) -> None:
        """Put a box into the scene whose corners can be dragged, and where who asked for it can see them."""
        self._put_away()
        self._kind = kind
        state = self._state
        corners = (state.fence_lower_enu_m, state.fence_upper_enu_m) if kind == "fence" else self._box_m
        colour = {"important": IMPORTANT, "forbidden": FORBIDDEN}.get(kind, FENCE)
        self._tool = BoxTool(self._server.scene, *corners, colour)
        if client is not None:
            step_back(client.camera, np.array(corners))
        self._apply.label = {"fence": "Apply the fence"}.get(kind, f"Apply: {kind}")
        self._apply.visible = self._cancel.visible = True

    def _applied(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if self._tool is None:
            return
        lower, upper = self._tool.box
        action: live.AnyAction = (
            live.MoveFence(lower_enu_m=lower, upper_enu_m=upper) if self._kind == "fence" else
            live.MarkRegion(kind=self._kind, lower_enu_m=lower, upper_enu_m=upper))  # type: ignore[arg-type]
        if isinstance(action, live.MoveFence) and self._moves_out(action):
            self._ask("Move the fence out", FENCE_OUT, lambda client: self._apply_action(action, client))
        else:
            self._apply_action(action, event.client)

    def _moves_out(self, action: live.MoveFence) -> bool:
        low, high = np.array(self._site.fence_lower_enu_m), np.array(self._site.fence_upper_enu_m)
        return bool((np.array(action.lower_enu_m) < low - SAME_M).any()
                    or (np.array(action.upper_enu_m) > high + SAME_M).any())

    def _apply_action(self, action: live.AnyAction, client: viser.ClientHandle | None) -> None:
        if self._do(action, client):
            self._put_away()

    def _put_away(self) -> None:
        if self._tool is not None:
            self._tool.remove()
        self._tool = None
        self._apply.visible = self._cancel.visible = False

    def _cleared(self) -> live.AnyAction | None:
        number = self._regions.value.split()[0]
        return live.ClearRegion(region_id=int(number)) if number.isdigit() else None

    def _goal_slider(self) -> None:
        goal = self._gui.add_slider("Coverage", 50, 100, 1, 95)
        self._button("Explore up to this", lambda: live.SetGoal(coverage=goal.value / 100.0), "blue")

    def _button(self, label: str, action: Callable[[], live.AnyAction | None], colour: str | None,
                icon: viser.IconName | None = None, ask: str = "", then: Callable[[], None] | None = None,
                ) -> viser.GuiButtonHandle:
        """A button that asks, where it is dangerous, does its action and says what came of it."""
        button = self._gui.add_button(label, color=colour, icon=icon)  # type: ignore[arg-type]

        def act(client: viser.ClientHandle | None) -> None:
            if then is not None:
                then()
            wanted = action()
            if wanted is not None:
                self._do(wanted, client)

        @button.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if ask:
                self._ask(label, ask, act)
            else:
                act(event.client)

        return button

    def _ask(self, label: str, question: str, act: Callable[[viser.ClientHandle | None], None]) -> None:
        with self._dialogue(label) as close:
            self._gui.add_markdown(question)
            yes = self._gui.add_button(f"Yes, {label.lower()}", color="red")
            no = self._gui.add_button("No", color="gray")

        @yes.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            close()
            act(event.client)

        no.on_click(lambda _: close())

    @contextmanager
    def _dialogue(self, title: str) -> Iterator[Callable[[], None]]:
        modal = self._gui.add_modal(title)
        with modal:
            yield modal.close

    def _do(self, action: live.AnyAction, client: viser.ClientHandle | None) -> bool:
        """Have it done. The newest answer stays for all to see; a refusal catches the eye of the person who asked."""
        try:
            answer = self._mission.do(action)
        except SwarmscanError as e:
            answer = OperatorAnswer(command_id="", accepted=False, text=str(e))
        said = "; ".join(f"vehicle {v.vehicle_id} {v.text}" for v in answer.vehicles)
        text = f"{answer.text}. {said}"
        self._answer.content = answer_html(answer.accepted, text)
        if client is not None and not answer.accepted:
            client.add_notification("Not done", text, color="red", auto_close_seconds=CLOSE_S)
        return answer.accepted
