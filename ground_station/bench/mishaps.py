"""What may not happen in a flight whatever dies in it, held against the files that it left."""

from __future__ import annotations

import csv
import json
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import common as mav

from missions.mission import Mission
from missions.run_folder import RunFolder
from missions.tlog import read_tlog


def wrong(mission: Mission, run: RunFolder) -> dict[str, Any]:
    """What may not happen; nothing in any of these when all is well."""
    with run.views_csv.open(encoding="utf-8") as f:
        kept = Counter(int(row["view_id"]) for row in csv.DictReader(f))
    taken = Counter(json.loads(card.read_bytes())["view_id"] for card in run.root.glob("sd_card_uav*/*.json"))
    flight = json.loads(run.flight.read_text(encoding="utf-8"))
    referee = json.loads(run.referee.read_text(encoding="utf-8"))
    lost = {v: o for v, o in flight["outcomes"].items() if o == "flown" and not kept[int(v)]}
    return {"views_taken_twice": [v for v, n in taken.items() if n > 1],
            "pictures_kept_twice": [v for v, n in kept.items() if n > 1],
            "pictures_lost": sorted((taken - kept).keys()), "views_without_picture": lost,
            "views_without_outcome": [v for v, o in flight["outcomes"].items() if not o],
            "armed_in_the_air_s": armed_in_the_air(mission, run), "collisions": referee["collisions"]}


def armed_in_the_air(mission: Mission, run: RunFolder) -> list[float]:
    """When a vehicle was told to arm that said it was in the air, simulated seconds."""
    aloft: dict[int, bool] = {}
    found = []
    for t_s, message in read_tlog(run.tlog, mission.clock.epoch_utc):
        kind = message.get_type()
        if kind == "EXTENDED_SYS_STATE":
            aloft[message.get_srcSystem()] = message.landed_state != mav.MAV_LANDED_STATE_ON_GROUND
        elif (kind == "COMMAND_LONG" and message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM
              and aloft.get(message.target_system)):
            found.append(round(t_s, 2))
    return found
