"""Wires are found where the thin lines of several pictures meet, and legs through them are not flown."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from ground_station.nbv.wires import NONE_STRUNG, STRUNG, Wires
from missions.camera import Camera, Pose
from missions.frames import Array
from missions.nbv_trial import Frame, TrialBrief
from missions.pose_lattice import AXIS_STEPS
from perception.mapping.line_votes import HEARSAY, MOST, STRONGEST_LINE, UNIT, Lines, LineVotes

CAMERA = Camera.from_diagonal_fov(456, 256, 84.0)
Picture = NDArray[np.uint8]
FRAMES_PER_STEP = 4
WIRE = np.array([[10.0, -20.0, 5.0], [10.0, 20.0, 5.0]])
POSES = [Pose((0.0, y, z), 0.0, 0.0) for y, z in itertools.product((-4.0, -1.0, 2.0, 5.0), (3.0, 6.5))]


def brief() -> TrialBrief:
    """Positions 5 m apart around a box that reaches from x = 7 to 18."""
    return TrialBrief(method="random", seed=1, object_min_enu_m=(7.0, -9.0, 0.0), object_max_enu_m=(18.0, 9.0, 12.0),
                      ground_up_m=0.0, camera_min_enu_m=(0.0, -7.5, 0.5), camera_max_enu_m=(20.0, 7.5, 10.5),
                      shape=(4, 3, 2), elevations_deg=(0.0,), azimuths=4, camera=CAMERA, sensing_range_m=25.0,
                      frames_per_step=1, starts=[(0, 1, 0, 0, 0)], poses=9)


def grass(seed: int) -> Picture:
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (256, 456, 1))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.repeat(np.clip(120.0 + 12.0 * smooth[..., None] / smooth.std(), 0, 255), 3, axis=2).astype(np.uint8)


def leaves(seed: int) -> Picture:
    """Before them no thin wire shows plainly."""
    return np.random.default_rng(seed).integers(60, 140, (256, 456, 3), dtype=np.uint8)


def seen(pose: Pose, wire: Array | None, seed: int) -> Picture:
    """Grass, of its own in every picture, and before it a wire one pixel wide."""
    return grass(seed) if wire is None else strung(grass(seed), pose, wire)


def strung(picture: Picture, pose: Pose, wire: Array) -> Picture:
    """The picture with the wire before it."""
    ends = (wire - np.array(pose.position_enu_m)) @ pose.enu_from_camera @ CAMERA.matrix.T
    a, b = (ends[:, :2] / ends[:, 2:]).round().astype(int).tolist()
    return np.asarray(cv2.line(picture.copy(), a, b, (70, 70, 70), 1), dtype=np.uint8)


def votes(points: Array, wire: Array | None, poses: list[Pose]) -> LineVotes:
    result = LineVotes(points, 25.0)
    for pose in poses:
        result.add(Lines.of(seen(pose, wire, POSES.index(pose))), CAMERA, pose)
    return result


def test_a_line_stands_out_as_far_as_a_byte_can_say_and_grass_does_not() -> None:
    strength = Lines.of(seen(POSES[0], WIRE, 0)).strength
    assert strength.max() == int(STRONGEST_LINE * UNIT)
    assert np.median(strength) < 0.3 * strength.max()
    assert not Lines.of(np.full((256, 456, 3), 90, np.uint8)).strength.any()


def test_pictures_agree_on_a_wire_where_it_is_and_nowhere_else() -> None:
    on, off = np.array([[10.0, y, 5.0] for y in (-2.0, 0.0, 2.0)]), np.array([[7.0, 0.0, 4.2], [12.0, 1.0, 6.5]])
    both = np.concatenate([on, off])
    there = votes(both, WIRE, POSES)
    assert (there.log_odds[:3] > STRUNG).all()
    assert (there.log_odds[3:] < NONE_STRUNG).all()
    assert (votes(both, None, POSES).log_odds < NONE_STRUNG).all()


def test_the_order_of_pictures_does_not_matter_and_far_ones_have_no_vote() -> None:
    points = np.array([[10.0, 0.0, 5.0], [60.0, 0.0, 5.0]])
    first, second = votes(points, WIRE, POSES), votes(points, WIRE, POSES[::-1])
    np.testing.assert_array_equal(first.log_odds, second.log_odds)
    assert first.log_odds[0] != 0.0
    assert first.log_odds[1] == 0.0


def test_the_plainer_a_wire_would_show_the_more_a_picture_says_that_there_is_none() -> None:
    points = np.array([[10.0, 0.0, 5.0], [22.0, 0.0, 5.0]])
    pictures = {"sky": np.full((256, 456, 3), 200, np.uint8), "grass": grass(0), "leaves": leaves(0)}
    said = {}
    for what, picture in pictures.items():
        found = LineVotes(points, 25.0)
        found.add(Lines.of(picture), CAMERA, POSES[1])
        said[what] = found.log_odds
    assert (said["sky"] == -MOST).all()
    assert (said["sky"] < said["grass"]).all()


def test_before_leaves_and_from_afar_many_pictures_say_no_more_than_one_could() -> None:
    grassy, leafy, far = (LineVotes(np.array([[x, 0.0, 5.0]]), 60.0) for x in (10.0, 10.0, 40.0))
    for k, pose in enumerate(POSES):
        grassy.add(Lines.of(grass(k)), CAMERA, pose)
        leafy.add(Lines.of(leaves(k)), CAMERA, pose)
        far.add(Lines.of(grass(k)), CAMERA, pose)
    assert leafy.log_odds == far.log_odds == HEARSAY
    assert grassy.log_odds < 3.0 * HEARSAY


def test_on_what_is_hidden_a_picture_has_no_vote() -> None:
    points, wall = np.array([[4.0, 0.0, 5.0], [8.0, 0.0, 5.0], [20.0, 0.0, 5.0]]), np.full((8, 12), 10.0, np.float32)
    seen_, hidden = LineVotes(points, 25.0), LineVotes(points, 25.0)
    seen_.add(Lines.of(grass(0)), CAMERA, POSES[1])
    hidden.add(Lines.of(grass(0)), CAMERA, POSES[1], wall)
    np.testing.assert_array_equal(hidden.log_odds[:2], seen_.log_odds[:2])
    assert seen_.log_odds[2] != 0.0
    assert hidden.log_odds[2] == 0.0


def test_pictures_that_would_not_show_a_wire_do_not_outvote_those_that_do() -> None:
    wire = np.array([[10.0, -20.0, 3.0], [10.0, 20.0, 3.0]])
    wires, lattice = Wires(brief()), brief().lattice
    through = lattice.flat((1, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((1, 0, 0))
    sky = np.full((256, 456, 3), 200, np.uint8)
    before_leaves = [Frame(vehicle=1, pose=pose, index=None, rgb=leaves(k)) for k, pose in enumerate(POSES)]
    before_sky = [Frame(vehicle=1, pose=pose, index=None, rgb=strung(sky, pose, wire)) for pose in POSES[:3]]
    for frame in 3 * before_leaves:
        wires.see(frame)
    wires.update()
    assert wires.looked_at_edges()[through]
    for frame in before_sky:
        wires.see(frame)
    wires.update()
    assert not wires.looked_at_edges()[through]


@pytest.mark.parametrize("there", [False, True])
def test_a_leg_across_a_wire_is_not_flown(there: bool) -> None:
    wires, lattice = Wires(brief()), brief().lattice
    wire = np.array([[10.0, -20.0, 3.0], [10.0, 20.0, 3.0]]) if there else None
    through = lattice.flat((1, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((1, 0, 0))
    outside = lattice.flat((0, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((0, 0, 1))
    for k, pose in enumerate(POSES):
        wires.see(Frame(vehicle=1, pose=pose, index=None, rgb=seen(pose, wire, k)))
    wires.update()
    assert wires.clear_edges()[through] == (not there)
    assert wires.clear_edges()[outside]


@pytest.mark.parametrize("there", [False, True])
def test_nobody_is_sent_to_stand_too_near_to_a_wire(there: bool) -> None:
    """It runs 60 cm below a position: legs from there would pass it, but the clearance is not kept."""
    wires, lattice = Wires(brief()), brief().lattice
    x, _, z = lattice.positions_enu_m[lattice.flat((2, 1, 0, 0, 0)) // lattice.orientations]
    wire = np.array([[x, -20.0, z - 0.6], [x, 20.0, z - 0.6]]) if there else None
    for k, (y, height) in enumerate(itertools.product((-4.0, -2.5, -1.0, 0.5, 2.0, 5.0), (1.0, 3.0, 6.5, 9.0))):
        pose = Pose((0.0, y, height), 0.0, 0.0)
        wires.see(Frame(vehicle=1, pose=pose, index=None, rgb=seen(pose, wire, k)))
    wires.update()
    clear = wires.clear_edges()
    above, below = (lattice.flat((2, 1, k, 0, 0)) // lattice.orientations for k in (1, 0))
    aside = lattice.flat((1, 1, 0, 0, 0)) // lattice.orientations
    assert clear[below].any() != there
    assert clear[above, AXIS_STEPS.index((0, 0, -1))] != there
    assert clear[above, AXIS_STEPS.index((-1, 0, 0))]
    assert clear[aside, AXIS_STEPS.index((0, 0, 1))]


def test_few_pictures_that_agree_on_a_wire_are_enough_and_one_that_shows_none_is_not() -> None:
    wire, lattice = np.array([[10.0, -20.0, 3.0], [10.0, 20.0, 3.0]]), brief().lattice
    through = lattice.flat((1, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((1, 0, 0))
    wired, free = Wires(brief()), Wires(brief())
    looked = []
    for k, pose in enumerate(POSES[:6:2]):
        wired.see(Frame(vehicle=1, pose=pose, index=None, rgb=seen(pose, wire, k)))
        free.see(Frame(vehicle=1, pose=pose, index=None, rgb=seen(pose, None, k)))
        wired.update()
        free.update()
        looked.append(bool(free.looked_at_edges()[through]))
    assert not wired.clear_edges()[through]
    assert free.clear_edges()[through]
    assert looked == sorted(looked)
    assert not looked[0]
    assert looked[-1]


def test_where_a_vehicle_stood_no_picture_needs_to_be_looked_at() -> None:
    wires, lattice = Wires(brief()), brief().lattice
    up = lattice.flat((2, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((0, 0, 1))
    assert not wires.looked_at_edges()[up]
    for height in np.arange(0.0, 11.0, 0.5):
        wires.was_at(np.array([*lattice.positions_enu_m[up[0]][:2], height]), 1.0)
    assert wires.looked_at_edges()[up]


@pytest.mark.parametrize("aside_m", [0.0, 0.03, 0.1, 0.2])
def test_looking_along_a_leg_from_its_start_leaves_no_place_that_nobody_looked_at(aside_m: float) -> None:
    wires, lattice = Wires(brief()), brief().lattice
    through = lattice.flat((1, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((1, 0, 0))
    at = lattice.positions_enu_m[through[0]] + [aside_m, 0.0, 0.0]
    wires.was_at(at, brief().fleet.clearance_m)
    for k in range(FRAMES_PER_STEP):
        wires.see(Frame(vehicle=1, pose=Pose((at[0], at[1], at[2]), 0.0, 0.0), index=None, rgb=grass(k)))
    wires.update()
    assert wires.looked_at_edges()[through]


@pytest.mark.parametrize(("wired", "opens_after"), [(3, 8), (6, None)])
def test_where_little_speaks_for_a_wire_the_pictures_of_two_steps_from_nearby_are_enough(
        wired: int, opens_after: int | None) -> None:
    """Of ten pictures the first show a line at a place of the leg, and the others none."""
    wires, lattice = Wires(brief()), brief().lattice
    up = lattice.flat((2, 1, 0, 0, 0)) // lattice.orientations, AXIS_STEPS.index((0, 0, 1))
    x, y, _ = lattice.positions_enu_m[up[0]]
    pose, wire = Pose((x - 9.0, y, 5.5), 0.0, 0.0), np.array([[x, -20.0, 5.0], [x, 20.0, 5.0]])
    looked = []
    for k in range(10):
        rgb = strung(grass(k), pose, wire) if k < wired else grass(k)
        wires.see(Frame(vehicle=1, pose=pose, index=None, rgb=rgb))
        wires.update()
        looked.append(bool(wires.looked_at_edges()[up]))
    first = looked.index(True) + 1 if any(looked) else None
    assert first == opens_after
