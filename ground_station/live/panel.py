"""The left side of the live page as HTML: the mission at a glance, alarms, one card per vehicle."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from itertools import pairwise

from ground_station.live.colours import COVERAGE, PICTURES, css, of_vehicle
from missions.live import LiveAlarm, LiveSite, LiveState, LiveVehicle

GOOD, WARN, BAD, MUTED, TEXT, LINE = "#34c48b", "#f2b134", "#f0544f", "#8fa0b5", "#e6edf5", "#5aa9f5"
SEVERITIES = {"danger": BAD, "warning": WARN, "notice": "#5aa9f5"}
PHASES = {"explore": "Exploring", "survey": "Surveying", "return": "Coming home", "over": "Over"}
STAGES = {"parked": "on its pad", "launching": "taking off", "ready": "hovering", "flying": "flying",
          "homing": "coming home", "swapping": "battery is changed", "lost": "lost"}
CURVE_W, CURVE_H = 320, 74
MOST_CURVE_POINTS = 200


def mission_html(site: LiveSite, state: LiveState, curve: Sequence[tuple[float, float, float]]) -> str:
    """Phase, times, coverage with its curve."""
    phase = PHASES.get(state.phase, state.phase) if state.started else "Waiting for Start"
    beside = f"{_clock(state.wall_s)} wall" if state.playing is None else \
        f"recording, {'paused' if state.playing.paused else speed_words(state.playing.speed)}"
    flown = f"{state.views_done} of {state.views_total} survey views" if state.views_total else \
        f"{state.pictures} pictures"
    left = f" · about {_clock(state.seconds_left)} left" if state.seconds_left > 0.0 else ""
    goal = f" / {state.goal_coverage:.0%} wanted" if state.goal_coverage is not None else ""
    note = f'<div style="color:{MUTED};font-size:11px">{html.escape(state.note)}</div>' if state.note else ""
    return _block(
        f'<div style="display:flex;align-items:center;gap:8px;margin-bottom:2px">'
        f'<span style="{_pill(LINE)}" id="phase">{phase}</span>'
        f'<span style="font-weight:600;font-size:13px;color:{TEXT}">{html.escape(site.title)}</span></div>'
        f'<div style="display:flex;justify-content:space-between;align-items:baseline">'
        f'<div><span style="font-size:34px;font-weight:700;color:{TEXT};letter-spacing:-1px">{state.coverage:.0%}'
        f'</span> <span style="color:{MUTED}">seen{goal}</span></div>'
        f'<div style="text-align:right;color:{MUTED};font-variant-numeric:tabular-nums">'
        f'<div><b style="color:{TEXT};font-size:15px">{_clock(state.t_s)}</b> flight</div>'
        f'<div id="beside">{beside}</div></div></div>'
        f"{_curve(curve, state)}"
        f'<div style="color:{MUTED};margin-top:2px">{flown}{left}</div>{note}')


def alarms_html(alarms: Sequence[LiveAlarm]) -> str:
    """What a person should know, worst first; a quiet line when there is nothing."""
    if not alarms:
        return _block(f'<span style="color:{GOOD}">●</span> <span style="color:{MUTED}">All is well</span>')
    return _block("".join(
        f'<div style="border-left:3px solid {SEVERITIES[a.severity]};background:{SEVERITIES[a.severity]}1f;'
        f'border-radius:3px;padding:4px 8px;margin:3px 0;color:{TEXT}">{html.escape(a.text)}</div>' for a in alarms))


def vehicles_html(site: LiveSite, vehicles: Sequence[LiveVehicle]) -> str:
    """A card per vehicle: what it does, its battery with the way home and the reserve on it, its views."""
    key = (f'<div style="color:{MUTED};font-size:11px">battery: <span style="color:{BAD}">▏</span>reserve, '
           '▨ way home</div>')
    return _block("".join(_card(site, v) for v in vehicles) + key)


def speed_words(speed: float) -> str:
    """How fast a recording is played."""
    return f"{speed:g} x" if speed else "as fast as possible"


def answer_html(accepted: bool, text: str) -> str:
    """What came of the newest action."""
    colour = GOOD if accepted else BAD
    style = f"border-left:3px solid {colour};padding-left:8px;margin-bottom:4px;color:{TEXT}"
    return _block(f'<div id="answer" style="{style}">{html.escape(text)}</div>')


def legend_html(which: str) -> str:
    """What the colours of the model mean; nothing for those that need no words."""
    if which not in PICTURES:
        return ""
    swatches = "".join(f'<div style="flex:1;height:8px;background:{css(c)}"></div>' for c in COVERAGE)
    *steps, last = (0, *PICTURES[which])
    names = "".join(f'<div style="flex:1;text-align:center">{n}</div>' for n in (*steps, f"{last}+"))
    return _block(f'<div style="display:flex;border-radius:4px;overflow:hidden">{swatches}</div>'
                  f'<div style="display:flex;color:{MUTED};font-size:10px">{names}</div>'
                  f'<div style="color:{MUTED};font-size:11px">{which} that show a place</div>')


def _card(site: LiveSite, v: LiveVehicle) -> str:
    colour = css(of_vehicle(v.vehicle_id))
    what = "paused" if v.held and v.flying and v.stage != "homing" else STAGES.get(v.stage, v.stage)
    if v.held and not v.flying:
        what = "waits on its pad"
    if v.reserve:
        what = "in reserve"
    elif v.dropped:
        what = "dropped" if not v.flying else "dropped, coming home"
    elif v.mode == "wait" and not v.held:
        what = "waits for others"
    views = f"{v.views_done} pictures" + (f" · {v.views_left} to fly" if v.views_left else "")
    if v.swaps_left:
        views += f" · {v.swaps_left} spare batter{'y' if v.swaps_left == 1 else 'ies'}"
    return (f'<div style="border-left:4px solid {colour};padding:3px 0 3px 9px;margin:7px 0">'
            f'<div style="display:flex;justify-content:space-between;align-items:baseline">'
            f'<span style="color:{TEXT}"><b>{v.vehicle_id}</b>&ensp;<span data-vehicle="{v.vehicle_id}">{what}</span>'
            f'</span><span style="color:{MUTED};font-size:11px">{views}</span></div>{_battery(site, v)}</div>')


def _battery(site: LiveSite, v: LiveVehicle) -> str:
    """The level; on it the way home, hatched, and the reserve as a mark; and what is to spare over both, in words."""
    needed = v.home_percent + site.reserve_percent
    colour = BAD if v.flying and v.battery_percent < needed + 2.0 else \
        WARN if v.battery_percent < site.threshold_percent + 5.0 else GOOD
    from_left = f"position:absolute;top:0;left:{site.reserve_percent:.0f}%;height:100%"
    home = (f'<div style="{from_left};width:{v.home_percent:.0f}%;'
            'background:repeating-linear-gradient(45deg,#0b1622d0 0 3px,transparent 3px 6px)"></div>')
    reserve = f'<div style="{from_left};width:3px;background:{BAD}"></div>'
    spare = max(0.0, v.battery_percent - needed)
    words = f"way home {v.home_percent:.0f} %, {spare:.0f} % to spare" if v.flying else ""
    return (f'<div style="display:flex;align-items:center;gap:8px;margin-top:2px">'
            f'<div style="position:relative;flex:1;height:12px;border-radius:6px;overflow:hidden;background:#26374a">'
            f'<div style="width:{v.battery_percent:.0f}%;height:100%;background:{colour}"></div>{home}{reserve}</div>'
            f'<span style="width:36px;text-align:right;color:{TEXT};font-variant-numeric:tabular-nums">'
            f'{v.battery_percent:.0f} %</span></div><div style="color:{MUTED};font-size:11px">{words}</div>')


def _curve(curve: Sequence[tuple[float, float, float]], state: LiveState) -> str:
    """Coverage, and the share of the survey that is flown, over time, as SVG."""
    every = max(1, len(curve) // MOST_CURVE_POINTS)
    points = [*curve[::every], *curve[-1:]]
    end_s = max(math.ceil(state.t_s), 1)  # a block that changes is built anew by the browser

    def line(column: int, until_s: float) -> str:
        known = [(p[0], p[column]) for p in points if column == 1 or p[column] > 0.0]
        if known:
            known.append((until_s, known[-1][1]))
        steps = [(x, y) for a, b in pairwise(known) for x, y in (a, (b[0], a[1]))] + known[-1:]
        return " ".join(f"{CURVE_W * x / end_s:.1f},{CURVE_H * (1.0 - y):.1f}" for x, y in steps)

    seen, flown = line(1, end_s), line(2, end_s)
    grid = "".join(f'<line x1="0" x2="{CURVE_W}" y1="{CURVE_H * s:.1f}" y2="{CURVE_H * s:.1f}" stroke="#2b3d52"/>'
                   for s in (0.0, 0.5, 1.0))
    area = f'<polygon points="0,{CURVE_H} {seen} {CURVE_W},{CURVE_H}" fill="{LINE}" opacity="0.18"/>' if seen else ""
    return (f'<svg viewBox="-1 -2 {CURVE_W + 2} {CURVE_H + 4}" style="width:100%;height:{CURVE_H}px" '
            f'preserveAspectRatio="none">{grid}{area}'
            f'<polyline points="{seen}" fill="none" stroke="{LINE}" stroke-width="2"/>'
            f'<polyline points="{flown}" fill="none" stroke="{GOOD}" stroke-width="2"/></svg>')


def _block(inner: str) -> str:
    return f'<div style="font-size:12.5px;line-height:1.45;padding:2px 12px">{inner}</div>'


def _pill(colour: str) -> str:
    return f"background:{colour}33;color:{colour};border-radius:9px;padding:1px 9px;font-weight:600;font-size:12px"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
