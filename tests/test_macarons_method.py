"""Method macarons under the tester's contract: it chooses candidates, the same ones every time, past no wall it saw."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ground_station.nbv.macarons import Macarons, MacaronsOptions, make_macarons
from missions.camera import Pose
from missions.errors import UserError
from missions.nbv_trial import Frame, TrialBrief
from missions.pose_lattice import Index5
from perception.macarons.field import Look
from perception.macarons.resnet import finite
from perception.macarons.weights import SHIPPED, Networks
from tests.depth_scene import CAMERA, halved, wall_picture

pytestmark = pytest.mark.xdist_group("macarons")
START: Index5 = (2, 1, 1, 0, 1)
OPTIONS = MacaronsOptions(width_px=112, height_px=64, proxies=1500, queries=60, samples=32, cloud_points=32)
FACING = math.pi / 2.0


def brief(**options: str) -> TrialBrief:
    """A wall at y = 0, 12 m high; the lattice reaches through it. Azimuth 1 of 4 looks at it from the south."""
    return TrialBrief(method="macarons", seed=3, object_min_enu_m=(-14.0, -1.0, 0.0),
                      object_max_enu_m=(14.0, 3.0, 12.0), ground_up_m=0.0,
                      camera_min_enu_m=(-16.0, -12.0, 2.0), camera_max_enu_m=(16.0, 12.0, 14.0),
                      shape=(8, 4, 3), elevations_deg=(0.0,), azimuths=4, camera=CAMERA, sensing_range_m=25.0,
                      frames_per_step=4, starts=[START], poses=10, options=options)


def leg(trial: TrialBrief, start: Index5, goal: Index5) -> list[Frame]:
    a, b = trial.lattice.pose(start), trial.lattice.pose(goal)
    frames = []
    for f in (0.25, 0.5, 0.75, 1.0):
        at = (1.0 - f) * np.array(a.position_enu_m) + f * np.array(b.position_enu_m)
        pose = Pose((float(at[0]), float(at[1]), float(at[2])), FACING, 0.0)
        rgb, _ = wall_picture(pose, 0.0, 12.0)
        frames.append(Frame(vehicle=1, pose=pose, index=goal if f == 1.0 else None, rgb=rgb))
    return frames


@pytest.fixture(scope="module")
def networks() -> Networks:
    made = Networks.fresh(1)
    for net in made.named().values():
        net.eval()
    return made


def play(networks: Networks, moves: int) -> list[Index5]:
    """Choices of the first moves; pictures always face the wall."""
    trial = brief()
    method, at, out = Macarons(trial, OPTIONS, networks), START, []
    for frame in leg(trial, (1, 1, 1, 0, 1), START):
        method.see(frame)
    for _ in range(moves):
        choice = method.choose(1, trial.lattice.neighbours(at))
        assert choice.index in trial.lattice.neighbours(at)
        assert choice.predicted_gain >= 0.0
        for frame in leg(trial, at, choice.index):
            method.see(frame)
        at = choice.index
        out.append(at)
    return out


def test_choices_are_candidates_new_ones_and_the_same_every_time(networks: Networks) -> None:
    first = play(networks, 3)
    assert first == play(networks, 3)
    assert len({START, *first}) == 4


def test_no_leg_goes_through_a_wall_that_was_seen(networks: Networks) -> None:
    trial = brief()
    method = Macarons(trial, OPTIONS, networks)
    for x in range(8):
        pose = trial.lattice.pose((x, 1, 1, 0, 1))
        _, depth = wall_picture(pose, 0.0, 12.0)
        look = Look(halved(depth).astype(np.float32), np.ones((128, 228), np.bool_), CAMERA.scaled(228, 128), pose)
        method.field.add(look, 0.2)
    clear = method._reachable(1, trial.lattice.neighbours(START))
    assert clear
    assert all(index[1] < 2 for index in clear)


def test_an_unknown_option_is_refused() -> None:
    with pytest.raises(UserError, match="cleverness"):
        make_macarons(brief(cleverness="3"))
    with pytest.raises(UserError, match="proxies"):
        make_macarons(brief(proxies="many"))


def test_the_weights_that_ship_fit_are_small_and_have_a_card_each() -> None:
    shipped = sorted(SHIPPED.glob("*.safetensors"))
    assert [path.stem for path in shipped] == ["depth", "gain", "occupancy"]
    assert sum(path.stat().st_size for path in shipped) < 60e6
    for path in shipped:
        card = path.with_suffix(".md").read_text(encoding="utf-8")
        assert all(f"## {part}" in card for part in ("Data", "Recipe", "Metrics", "Limits"))
    networks = Networks.load(SHIPPED)
    assert all(finite(net) for net in networks.named().values())
