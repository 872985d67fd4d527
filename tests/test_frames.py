"""Laws of frames and cameras: every conversion there and back."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from missions import frames
from missions.camera import Camera, Pose

yaws = st.floats(-math.pi, math.pi, exclude_max=True)
elevations = st.floats(-1.55, 1.55)


@given(yaws, elevations)
def test_camera_axes_are_a_right_handed_rotation(yaw, elevation):
    r = frames.enu_from_camera(yaw, elevation)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert math.isclose(np.linalg.det(r), 1.0, abs_tol=1e-12)
    np.testing.assert_allclose(r[:, 2], frames.forward_enu(yaw, elevation), atol=1e-12)
    assert abs(r[2, 0]) < 1e-12, "no roll: the picture's right axis is horizontal"
    assert r[2, 1] <= 0, "down points down"


@given(yaws, elevations, st.floats(-1.5, 1.5))
def test_roll_turns_right_to_down_and_leaves_the_view(yaw, elevation, roll):
    level, rolled = frames.enu_from_camera(yaw, elevation), frames.enu_from_camera(yaw, elevation, roll)
    np.testing.assert_allclose(rolled[:, 2], level[:, 2], atol=1e-12)
    np.testing.assert_allclose(rolled[:, 0], math.cos(roll) * level[:, 0] + math.sin(roll) * level[:, 1], atol=1e-12)
    assert math.isclose(np.linalg.det(rolled), 1.0, abs_tol=1e-12)
    assert math.isclose(frames.roll_about_axis(rolled), roll, abs_tol=1e-9)


@given(yaws, elevations)
def test_quaternion_there_and_back(yaw, elevation):
    r = frames.enu_from_camera(yaw, elevation)
    np.testing.assert_allclose(frames.matrix_from_quaternion(frames.quaternion_from_matrix(r)), r, atol=1e-9)


@given(yaws, elevations)
def test_forward_there_and_back(yaw, elevation):
    back = frames.yaw_elevation_from_forward(frames.forward_enu(yaw, elevation))
    assert abs(frames.wrap_pi(back[0] - yaw)) < 1e-9
    assert abs(back[1] - elevation) < 1e-9


@given(yaws)
def test_heading_there_and_back(yaw):
    assert abs(frames.wrap_pi(frames.yaw_enu_from_heading_deg(frames.heading_deg_from_yaw_enu(yaw)) - yaw)) < 1e-9


def test_heading_of_the_compass_points():
    assert frames.heading_deg_from_yaw_enu(0.0) == 90.0
    assert frames.heading_deg_from_yaw_enu(math.pi / 2) == 0.0


@given(st.tuples(*[st.floats(-500, 500)] * 3), st.floats(-70, 70), st.floats(-180, 180))
def test_site_there_and_back_within_a_micrometre(point, lat, lon):
    site = frames.Site(lat, lon, 40.0)
    np.testing.assert_allclose(site.enu_from_geodetic(*site.geodetic_from_enu(np.array(point))), point, atol=1e-6)


@given(st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_ned_is_its_own_inverse(v):
    np.testing.assert_array_equal(frames.ned_from_enu(frames.ned_from_enu(np.array(v))), v)


def test_camera_sees_84_degrees_across_its_diagonal():
    camera = Camera.from_diagonal_fov(1920, 1080, 84.0)
    corners = camera.rays_camera()[[0, -1], [0, -1]]
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    assert abs(math.degrees(math.acos(corners[0] @ corners[1])) - 84.0) < 0.1


@given(st.tuples(*[st.floats(-50, 50)] * 3), yaws, elevations, st.floats(0.5, 100))
def test_the_optical_axis_lands_on_the_principal_point(position, yaw, elevation, depth):
    pose = Pose(position, yaw, elevation)
    camera = Camera.from_diagonal_fov(456, 256, 84.0)
    ahead = np.array(position) + depth * frames.forward_enu(yaw, elevation)
    seen = (pose.camera_from_enu @ [*ahead, 1.0])[:3]
    pixel = camera.matrix @ seen / seen[2]
    np.testing.assert_allclose(pixel[:2], [228.0, 128.0], atol=1e-6)


@given(st.floats(-66, 66), st.floats(0.0, 200.0), st.floats(-math.pi, math.pi))
def test_anchor_is_within_a_centimetre_of_a_true_enu_frame(lat, distance_m, bearing):
    site = frames.Site(lat, 6.8861, 40.0)
    point = np.array([distance_m * math.cos(bearing), distance_m * math.sin(bearing), 5.0])
    geodetic = site.geodetic_from_enu(point)
    to_enu = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={site.lon_deg} +lat_0={site.lat_deg} +h_0={site.alt_m}")
    assert np.linalg.norm(np.array(to_enu.transform(geodetic[1], geodetic[0], geodetic[2])) - point) < 0.01
    np.testing.assert_array_equal(site.geodetic_rows_from_enu(np.stack([point, point])), [geodetic, geodetic])
