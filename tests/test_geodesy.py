"""Geodesy: against PROJ's numbers and the golden file, round trips, similarities whose answer is known, refusals."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trackrs as tr
from trackrs import geodesy

DATA = Path(__file__).resolve().parent / "data"
PROJ = json.loads((DATA / "geodesy_pyproj.json").read_text())
GOLDEN = json.loads((DATA / "frames.json").read_text())

# A right-handed array, 1 km across, far from the origin of its own frame.
ELEMENTS = np.array(
    [[4000.0, 0, 250], [5000, 30, 262], [4500, 866, 248], [4400, 300, 330], [4900, 700, 255]],
)
ORIGIN = (0.95, 3.1415, 12.0)


def radians(rows):
    rows = np.array(rows)
    return np.column_stack([np.radians(rows[:, :2]), rows[:, 2]])


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


# --- WGS-84 ----------------------------------------------------------------------------------------------------------


def test_ecef_agrees_with_proj():
    positions, ecef = radians(PROJ["geodetic_deg"]), np.array(PROJ["ecef"])
    np.testing.assert_allclose(geodesy.geodetic_to_ecef(positions), ecef, rtol=0, atol=2e-8)
    back = geodesy.ecef_to_geodetic(ecef)
    np.testing.assert_allclose(back[:, 2], positions[:, 2], rtol=0, atol=2e-8)
    np.testing.assert_allclose(back[:, 0], positions[:, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(geodesy.geodetic_to_ecef(back), ecef, rtol=0, atol=2e-8)


def test_golden_ecef_and_ned():
    positions = np.column_stack([GOLDEN["lat_rad"], GOLDEN["lon_rad"], GOLDEN["h"]])
    np.testing.assert_allclose(geodesy.geodetic_to_ecef(positions), GOLDEN["ecef"], rtol=1e-9)
    ned = geodesy.LocalFrame(positions[0]).from_geodetic(positions)
    np.testing.assert_allclose(ned, GOLDEN["ned_about_first"], rtol=1e-9, atol=5e-9)


def test_one_point_and_many_agree_and_come_out_read_only():
    positions = radians([[48.1, 11.6, 500.0], [-90.0, 0.0, 2800.0]])
    many = geodesy.geodetic_to_ecef(positions)
    assert many.shape == (2, 3)
    assert np.array_equal(geodesy.geodetic_to_ecef(positions[0]), many[0])
    assert geodesy.ecef_to_geodetic(np.zeros((0, 3))).shape == (0, 3)
    frame = geodesy.LocalFrame(positions[0])
    for array in (many, geodesy.ecef_to_geodetic(many[0]), frame.rotation, frame.from_ecef(many), frame.to_ecef(many)):
        assert not array.flags.writeable


@given(
    lat=st.floats(-np.pi / 2, np.pi / 2),
    lon=st.floats(-np.pi, np.pi),
    height=st.floats(-11e3, 4e7),
)
def test_round_trip_to_a_micrometre(lat, lon, height):
    point = geodesy.geodetic_to_ecef([lat, lon, height])
    back = geodesy.ecef_to_geodetic(point)
    assert abs(back[0] - lat) * 7e6 < 1e-6
    assert abs(back[2] - height) < 1e-6
    assert np.linalg.norm(geodesy.geodetic_to_ecef(back) - point) < 1e-6


@pytest.mark.parametrize(
    ("position", "start", "says"),
    [
        ([48.1, 0.2, 0.0], "lat[0] = 48.1", "radians"),
        ([np.nan, 0.2, 0.0], "lat[0] = NaN", "radians"),
        ([0.8, 11.6, 0.0], "lon[0] = 11.6", "degrees"),
        ([2.4, 0.8, 0.0], "lat[0] = 2.4", "longitude first"),
        ([0.8, 0.2, np.inf], "height[0] = inf", "metres"),
    ],
)
def test_degrees_and_swapped_angles_are_refused(position, start, says):
    for call in (geodesy.geodetic_to_ecef, geodesy.LocalFrame((0, 0, 0)).from_geodetic):
        with pytest.raises(tr.ParameterError) as caught:
            call(position)
        assert str(caught.value).startswith(start)
        assert says in str(caught.value)
    with pytest.raises(tr.ParameterError, match=says):
        geodesy.LocalFrame(position)


def test_the_row_at_fault_is_named():
    with pytest.raises(tr.ParameterError, match=r"^lat\[1\]"):
        geodesy.geodetic_to_ecef([[0.1, 0.2, 0.0], [54.0, 10.0, 0.0]])


@pytest.mark.parametrize("value", [[1.0, 2.0], [[1.0, 2.0]], 3.0, np.zeros((1, 1, 3)), "north", [[1.0, 2.0, 3.0, 4.0]]])
def test_other_shapes_are_refused(value):
    with pytest.raises(tr.DimensionError):
        geodesy.geodetic_to_ecef(value)
    with pytest.raises(tr.DimensionError):
        geodesy.LocalFrame((0, 0, 0)).to_ecef(value)


def test_ecef_must_be_finite():
    with pytest.raises(tr.NonFiniteError, match="points is not finite at index 4"):
        geodesy.ecef_to_geodetic([[1e7, 0.0, 0.0], [0.0, np.nan, 0.0]])


# --- local frames ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", PROJ["local"], ids=lambda case: str(case["origin_deg"]))
def test_local_coordinates_agree_with_proj(case):
    origin, positions, enu = radians([case["origin_deg"]])[0], radians(case["points_deg"]), np.array(case["enu"])
    ned = enu[:, [1, 0, 2]] * [1, 1, -1]
    for axes, expected in (("enu", enu), ("ned", ned)):
        frame = geodesy.LocalFrame(origin, axes)
        np.testing.assert_allclose(frame.from_geodetic(positions), expected, rtol=0, atol=2e-8)
        np.testing.assert_allclose(frame.from_geodetic(frame.to_geodetic(expected)), expected, rtol=0, atol=1e-7)
        np.testing.assert_allclose(frame.from_ecef(frame.to_ecef(expected)), expected, rtol=0, atol=1e-8)


def test_a_track_across_the_antimeridian_and_over_the_pole_is_a_straight_line():
    steps = np.linspace(-5e3, 5e3, 201)
    for origin in ((0.5, np.pi, 0.0), (np.pi / 2, 0.3, 0.0)):
        frame = geodesy.LocalFrame(origin, "enu")
        line = np.column_stack([steps, 0 * steps, 0 * steps])
        geodetic = frame.to_geodetic(line)
        assert np.ptp(geodetic[:, 1]) > 3.0  # the longitude jumps
        np.testing.assert_allclose(frame.from_geodetic(geodetic), line, rtol=0, atol=1e-7)


def test_rotation_and_covariances():
    frame = geodesy.LocalFrame((0.7, -2.0, 100.0), "enu")
    r = frame.rotation
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-15)
    up = [np.cos(0.7) * np.cos(-2.0), np.cos(0.7) * np.sin(-2.0), np.sin(0.7)]
    np.testing.assert_allclose(r[2], up, atol=1e-15)
    covs = np.array([np.diag([1.0, 4.0, 9.0]), [[2.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]]])
    np.testing.assert_allclose(frame.cov_from_ecef(covs), r @ covs @ r.T, atol=1e-14)
    np.testing.assert_allclose(frame.cov_to_ecef(frame.cov_from_ecef(covs[1])), covs[1], atol=1e-14)
    with pytest.raises(tr.ParameterError, match="covs"):
        frame.cov_from_ecef(np.diag([1.0, -1.0, 1.0]))


def test_local_frame_is_a_value():
    frame = geodesy.LocalFrame([0.7, -2.0, 100.0], "enu")
    assert frame == geodesy.LocalFrame((0.7, -2.0, 100.0), axes="enu")
    assert frame != geodesy.LocalFrame((0.7, -2.0, 100.0))
    assert pickle.loads(pickle.dumps(frame)) == copy.copy(frame) == frame
    assert len({frame, copy.copy(frame)}) == 1
    with pytest.raises(tr.ParameterError, match="axes = nwu"):
        geodesy.LocalFrame((0, 0, 0), "nwu")


# --- similarity ------------------------------------------------------------------------------------------------------


def test_golden_similarity():
    golden = GOLDEN["helmert"]
    found = geodesy.fit_similarity(golden["src"], golden["dst"])
    np.testing.assert_allclose(found.scale, golden["scale"], rtol=1e-9)
    np.testing.assert_allclose(found.rotation, golden["R"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.translation, golden["t"], rtol=1e-9)
    np.testing.assert_allclose(found.apply(golden["src"]), golden["dst"], rtol=1e-9)
    np.testing.assert_allclose(found.parameters[3:], [np.log(golden["scale"]), 0, 0, 0.3], atol=1e-9)
    assert found.parameters.shape == (7,)
    assert (found.dof, found.residuals.shape, found.cov.shape) == (5, (4, 3), (7, 7))


def residual_jacobian(source, scale, r, t):
    """Derivative of the images by (t, ln s, ω), by central differences of the textbook formula."""

    def images(x):
        turn = rotation(x[4:], np.linalg.norm(x[4:])) if np.any(x[4:]) else np.eye(3)
        return (t + x[:3] + scale * np.exp(x[3]) * source @ (turn @ r).T).ravel()

    return np.column_stack([(images(1e-5 * e) - images(-1e-5 * e)) / 2e-5 for e in np.eye(7)])


def test_covariance_is_that_of_least_squares():
    rng = np.random.default_rng(3)
    r, t = rotation([1, 2, -1], 2.1), np.array([500.0, -200.0, 40.0])
    std = np.array([0.1, 0.2, 0.1, 0.4, 0.3])
    target = t + 1.1 * ELEMENTS @ r.T + std[:, None] * rng.standard_normal((5, 3))
    found = geodesy.fit_similarity(ELEMENTS, target, 1 / std**2)
    jacobian = residual_jacobian(ELEMENTS, found.scale, found.rotation, found.translation)
    whiten = np.repeat(1 / std, 3)
    residuals = (target - found.apply(ELEMENTS)).ravel()
    np.testing.assert_allclose(found.residuals.ravel(), residuals, atol=1e-9)
    np.testing.assert_allclose(found.variance, np.sum((whiten * residuals) ** 2) / 8, rtol=1e-9)
    # At the least-squares solution the residuals are orthogonal to every column.
    assert np.max(np.abs(jacobian.T @ (whiten**2 * residuals)) / np.linalg.norm(jacobian, axis=0)) < 1e-5
    expected = np.linalg.inv((whiten[:, None] * jacobian).T @ (whiten[:, None] * jacobian)) * found.variance
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found.cov / scale, expected / scale, rtol=0, atol=1e-5)

    own = np.diag([0.5, 0.2, 0.1])
    point = np.array([[1000.0, 2000.0, -30.0]])
    images = found.propagate(point, own[np.newaxis])
    j = residual_jacobian(point, found.scale, found.rotation, found.translation)
    by_hand = j @ found.cov @ j.T + found.scale**2 * found.rotation @ own @ found.rotation.T
    np.testing.assert_allclose(images.covs[0], by_hand, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(images.std[0], np.sqrt(np.diag(by_hand)), rtol=1e-5)
    np.testing.assert_allclose(found.apply(point[0]), images.positions[0])
    assert len(images) == 1


def test_coordinates_of_earth_radius_lose_no_digits():
    frame = geodesy.LocalFrame((0.9, 0.2, 0.0), "enu")
    local = ELEMENTS - ELEMENTS.mean(axis=0)
    found = geodesy.fit_similarity(frame.to_ecef(local), local)
    np.testing.assert_allclose(found.rotation, frame.rotation, atol=1e-11)
    np.testing.assert_allclose(found.apply(frame.to_ecef(local)), local, atol=1e-8)


@pytest.mark.parametrize(
    ("source", "target", "says"),
    [
        (ELEMENTS[:2], ELEMENTS[:2], "source = 2 points"),
        (np.outer(np.arange(5.0), [1, 2, 3]), ELEMENTS, "source = 5 collinear points"),
        (ELEMENTS, np.outer(np.arange(5.0), [1, 2, 3]), "target = 5 collinear points"),
        (np.ones((5, 3)), ELEMENTS, "source = 5 collinear points"),
    ],
)
def test_points_that_fix_no_similarity_are_refused(source, target, says):
    with pytest.raises(tr.ParameterError, match=says):
        geodesy.fit_similarity(source, target)


def test_other_bad_input_of_the_fit():
    with pytest.raises(tr.DimensionError, match="target"):
        geodesy.fit_similarity(ELEMENTS, ELEMENTS[:4])
    with pytest.raises(tr.DimensionError, match="weights"):
        geodesy.fit_similarity(ELEMENTS, ELEMENTS, [1.0])
    with pytest.raises(tr.ParameterError, match=r"weights\[1\] = -1"):
        geodesy.fit_similarity(ELEMENTS, ELEMENTS, [1.0, -1.0, 1.0, 1.0, 1.0])
    with pytest.raises(tr.NonFiniteError, match="target"):
        geodesy.fit_similarity(ELEMENTS, np.where(ELEMENTS == 866.0, np.nan, ELEMENTS))
    found = geodesy.fit_similarity(ELEMENTS, ELEMENTS)
    with pytest.raises(tr.DimensionError, match="covs"):
        found.propagate(ELEMENTS, np.zeros((2, 3, 3)))
    with pytest.raises(tr.NonFiniteError, match="points"):
        found.apply([0.0, np.inf, 0.0])


# --- an array in the common frame ------------------------------------------------------------------------------------


def placed_truth():
    r, t = rotation([0.1, -0.2, 1.0], 2.0), np.array([700.0, -900.0, 30.0])
    ned = t + ELEMENTS @ r.T
    return ned, geodesy.LocalFrame(ORIGIN).to_geodetic(ned)


def test_an_array_is_placed_in_one_call():
    ned, fixes = placed_truth()
    fixes = np.where(np.arange(5)[:, None] == 1, np.nan, fixes)
    placed = geodesy.place_array(ELEMENTS, fixes, [0.5, 0.5, 1.5], ORIGIN)
    np.testing.assert_allclose(placed.positions, ned, rtol=0, atol=1e-6)
    assert placed.dof == placed.similarity.dof == 5
    assert placed.chi_square < 1e-9
    assert np.isnan(placed.similarity.residuals[1]).all()
    assert np.isfinite(placed.similarity.residuals[0]).all()
    # Heights are worse known; and the placed elements are better known than one fix.
    std = np.sqrt(np.diagonal(placed.covs, axis1=1, axis2=2))
    assert (std[:, 2] > 1.5 * std[:, 0]).all()
    assert (std[[0, 2, 3, 4]] < [0.5, 0.5, 1.5]).all()


def test_placing_weighs_every_fix_by_its_own_covariance():
    ned, _ = placed_truth()
    rng = np.random.default_rng(5)
    std = np.array([[0.1, 0.3, 2.0], [1.0, 1.0, 1.0], [0.2, 0.2, 0.4], [0.5, 0.1, 1.0], [2.0, 2.0, 5.0]])
    frame = geodesy.LocalFrame(ORIGIN)
    noisy = ned + std * rng.standard_normal((5, 3))
    placed = geodesy.place_array(ELEMENTS, frame.to_geodetic(noisy), std, ORIGIN)
    s = placed.similarity
    jacobian = residual_jacobian(ELEMENTS, s.scale, s.rotation, s.translation) / std.ravel()[:, None]
    residuals = ((noisy - placed.positions) / std).ravel()
    np.testing.assert_allclose(placed.chi_square, residuals @ residuals, rtol=1e-3)
    # The fixes' axes differ from those of the origin by their distance over the Earth's radius, some 1e-3.
    slope = jacobian.T @ residuals / np.linalg.norm(jacobian, axis=0)
    assert np.max(np.abs(slope)) < 1e-2
    whole = np.linalg.inv(jacobian.T @ jacobian)
    for i in range(5):
        block = jacobian[3 * i : 3 * i + 3] * std[i][:, None]
        expected = block @ whole @ block.T
        np.testing.assert_allclose(placed.covs[i], expected, atol=1e-2 * np.max(expected))


def test_a_mirrored_survey_shows_in_chi_square():
    _, fixes = placed_truth()
    mirrored = geodesy.place_array(ELEMENTS * [1, 1, -1], fixes, 0.5, ORIGIN)
    assert mirrored.chi_square > 100 * mirrored.dof


def test_arrays_that_cannot_be_placed_are_refused():
    _, fixes = placed_truth()
    two = np.where(np.arange(5)[:, None] < 2, fixes, np.nan)
    with pytest.raises(tr.ParameterError, match="fixes = 2 of 5 elements"):
        geodesy.place_array(ELEMENTS, two, 1.0, ORIGIN)
    with pytest.raises(tr.ParameterError, match="elements with a fix = 5 collinear points"):
        geodesy.place_array(np.outer(np.arange(5.0), [1, 2, 3]), fixes, 1.0, ORIGIN)
    with pytest.raises(tr.ParameterError, match=r"lat\[0\] = .*radians"):
        geodesy.place_array(ELEMENTS, np.degrees(fixes), 1.0, ORIGIN)
    half = fixes.copy()
    half[3, 2] = np.nan
    with pytest.raises(tr.ParameterError, match=r"height\[3\] = NaN"):
        geodesy.place_array(ELEMENTS, half, 1.0, ORIGIN)
    with pytest.raises(tr.ParameterError, match=r"std\[0\] = 0"):
        geodesy.place_array(ELEMENTS, fixes, 0.0, ORIGIN)
    with pytest.raises(tr.DimensionError, match="std"):
        geodesy.place_array(ELEMENTS, fixes, [1.0, 2.0], ORIGIN)
    with pytest.raises(tr.DimensionError, match="fixes"):
        geodesy.place_array(ELEMENTS, fixes[:4], 1.0, ORIGIN)
    with pytest.raises(tr.DimensionError, match="origin"):
        geodesy.place_array(ELEMENTS, fixes, 1.0, ORIGIN[:2])
    with pytest.raises(tr.ParameterError, match="radians"):
        geodesy.place_array(ELEMENTS, fixes, 1.0, (54.0, 10.0, 0.0))
