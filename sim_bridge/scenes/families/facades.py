"""Walls with rows of recessed windows, cut into axis-aligned masses of a building."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sim_bridge.scenes.families.body import Body

RECESS_M = 0.25


@dataclass(frozen=True)
class Mass:
    """An upright box of a building: its corners in x and y, foot and top."""

    x0: float
    y0: float
    x1: float
    y1: float
    z0: float
    z1: float


@dataclass(frozen=True)
class Windows:
    """How a wall is glazed: bays of about bay_m, each window this wide and high above a sill, with so many panes."""

    bay_m: float
    width_m: float
    height_m: float
    sill_m: float
    panes: int = 2
    frame: str = "trim"
    surround: str = ""
    """Material of sill and lintel, none if empty."""


def raise_mass(body: Body, mass: Mass, material: str) -> None:
    """Fill the mass."""
    body.blocks.add(material, (mass.x0, mass.y0, mass.z0), (mass.x1, mass.y1, mass.z1))


def glaze(body: Body, mass: Mass, storey_m: float, windows: Windows, sides: str = "-x +x -y +y",
          first: int = 0) -> None:
    """Windows in every bay of every storey from the first on, on the sides named."""
    storeys = int((mass.z1 - mass.z0 + 0.01) / storey_m)
    for side in sides.split():
        length = mass.x1 - mass.x0 if side[1] == "y" else mass.y1 - mass.y0
        bays = max(1, round(length / windows.bay_m))
        wide = min(windows.width_m, length / bays - 0.3)
        for bay in range(bays):
            middle = (bay + 0.5) * length / bays
            for storey in range(first, storeys):
                sill = mass.z0 + storey * storey_m + windows.sill_m
                pane = (middle - wide / 2, sill, middle + wide / 2, sill + windows.height_m)
                opening(body, mass, side, pane, windows)


def opening(body: Body, mass: Mass, side: str, rectangle: tuple[float, float, float, float], windows: Windows) -> None:
    """One window: (along, up, along, up) in metres from the side's lower x or y, and absolute heights."""
    u0, v0, u1, v1 = rectangle
    place = _placer(mass, side)
    if windows.surround:
        if v0 > 0.2:
            body.blocks.add(windows.surround, place(u0 - 0.12, v0 - 0.14, -0.05), place(u1 + 0.12, v0, 0.1))
        body.blocks.add(windows.surround, place(u0 - 0.12, v1, -0.05), place(u1 + 0.12, v1 + 0.2, 0.06))
    body.blocks.cut(place(u0, v0, -RECESS_M), place(u1, v1, 0.0))
    body.blocks.add("glass", place(u0, v0, -RECESS_M), place(u1, v1, -RECESS_M + 0.04))
    frame = (-RECESS_M + 0.04, -RECESS_M + 0.1)
    for edge in (u0, u1 - 0.07):
        body.blocks.add(windows.frame, place(edge, v0, frame[0]), place(edge + 0.07, v1, frame[1]))
    for edge in (v0, v1 - 0.07):
        body.blocks.add(windows.frame, place(u0, edge, frame[0]), place(u1, edge + 0.07, frame[1]))
    for i in range(1, windows.panes):
        u = u0 + (u1 - u0) * i / windows.panes
        body.blocks.add(windows.frame, place(u - 0.03, v0, frame[0]), place(u + 0.03, v1, frame[1]))


def band(body: Body, mass: Mass, material: str, low: float, high: float, out: float) -> None:
    """A moulding, parapet or eaves board around a mass."""
    body.blocks.add(material, (mass.x0 - out, mass.y0 - out, low), (mass.x1 + out, mass.y1 + out, high))


def parapet(body: Body, mass: Mass, material: str, height: float = 0.8, thick: float = 0.3) -> None:
    """A wall around a flat roof of gravel."""
    raise_mass(body, Mass(mass.x0, mass.y0, mass.x1, mass.y1, mass.z1, mass.z1 + height), material)
    inner = (mass.x0 + thick, mass.y0 + thick), (mass.x1 - thick, mass.y1 - thick)
    body.blocks.cut((*inner[0], mass.z1), (*inner[1], mass.z1 + height))
    body.blocks.add("gravel", (*inner[0], mass.z1 - 0.05), (*inner[1], mass.z1))


def _placer(mass: Mass, side: str) -> Callable[[float, float, float], tuple[float, float, float]]:
    """Maps (along, up, outward) on a side to a point."""
    def place(u: float, v: float, out: float) -> tuple[float, float, float]:
        if side[1] == "y":
            return mass.x0 + u, (mass.y0 - out if side[0] == "-" else mass.y1 + out), v
        return (mass.x0 - out if side[0] == "-" else mass.x1 + out), mass.y0 + u, v
    return place
