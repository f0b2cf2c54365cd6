"""A load on a heavy elastic rope: marched along the rope, as a limit of lumped ropes, and on plants of 64 elements."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from problems import polynomial_path
from scipy.interpolate import CubicSpline, make_interp_spline
from thinned import thinned

import servocore as sc
from servocore.numerics.compiled_calls import Array
from servocore.references.profiles import polynomial
from servocore.scenes.elastic_bar import dalembert
from servocore.scenes.heavy_rope import HeavyRope, heavy_rope
from servocore.scenes.rope_marching import RopeMotion, march_rope

STEPPY = sc.rest_to_rest((0.0, -8.0), (1.0, -8.0), 4.0, sc.DEGREE5)
VALUES = heavy_rope().parameter_values()
SMOOTH = sc.rest_to_rest((0.0, -8.0), (5.0, -7.0), 6.0, polynomial(17))
FAST = sc.rest_to_rest((0.0, 0.0, -8.0), (1.0, 0.5, -7.5), 1.5, polynomial(13))


@cache
def marched(path: sc.Reference = SMOOTH, step: float = 0.01) -> RopeMotion:
    return march_rope(path, VALUES, step)


def stray(elements: int, path: sc.Reference, values: dict[str, float], motion: RopeMotion, step: float) -> float:
    """Largest distance of the load from its path, on a plant under the inputs of a march."""
    scene = heavy_rope(elements, path.dimension).with_reference(path).with_parameters(**values)
    start = HeavyRope(elements, path.dimension).at_rest(values, path.jet(path.start_time, 0)[0])
    begin = path.start_time - step * np.ceil(1.2 * motion.travel_time / step)
    t = begin + step * np.arange(round((path.end_time - begin + motion.travel_time) / step) + 1)
    method = sc.EnergyMomentum(native=False)
    found = sc.simulate(scene, CubicSpline(motion.t, motion.inputs), t=t, start=start, method=method, step=step)
    return float(found["tracking_error"].max())


def test_the_march_is_of_fourth_order() -> None:
    t = np.linspace(-0.2, 6.2, 65)

    def drives(step: float) -> Array:
        motion = marched(SMOOTH, step)
        return np.asarray(make_interp_spline(motion.t, np.hstack([motion.inputs, motion.position[-1]]), k=7)(t))

    exact = drives(0.005)
    coarse, middle, fine = (np.abs(drives(step) - exact).max(axis=0) for step in (0.08, 0.04, 0.02))
    np.testing.assert_allclose(np.log2([coarse / middle, middle / fine]), 4.0, atol=0.25)
    assert fine.max() < 1e-7 * np.abs(exact).max()


def test_straight_up_the_rope_is_the_elastic_bar_of_d_alembert() -> None:
    path = sc.rest_to_rest((0.0, -8.0), (0.0, -7.0), 1.5, polynomial(17))
    values = VALUES | {"rope_stiffness": 2e4, "trolley_mass": 0.0}
    motion = march_rope(path, values, 1e-3)
    bar = {"length": 8.0, "axial_stiffness": 2e4, "line_mass": 1.0, "end_mass": 100.0}
    climb = sc.rest_to_rest((-8.0,), (-7.0,), 1.5, polynomial(17))
    weight = VALUES["gravity"] * (100.0 + 8.0)
    np.testing.assert_allclose(motion.inputs[:, 1] - weight, dalembert(motion.t, climb, bar)["u"], atol=1e-3)
    np.testing.assert_array_equal(motion.inputs[:, 0], 0.0)


def test_a_massless_inextensible_rope_is_that_of_the_overhead_crane_at_its_length() -> None:
    crane = sc.scenes.overhead_crane()
    t = np.linspace(0.0, 3.0, 31)
    exact = crane.exact(t)
    values = VALUES | {"rope_mass": 0.0, "rope_stiffness": np.inf}
    for k, length in enumerate(exact["l"]):
        motion = march_rope(crane.reference, values | {"rope_length": float(length)}, 0.1)
        (now,) = np.flatnonzero(np.abs(motion.t - t[k]) < 1e-9)
        np.testing.assert_allclose(motion.position[-1, now], [exact["s"][k], 0.0], atol=1e-9)
        assert np.linalg.norm(motion.force[-1, now]) == pytest.approx(exact["tension"][k], rel=1e-9)


def test_drives_work_from_a_wave_s_travel_time_before_the_path_to_as_long_after_it() -> None:
    motion = marched(FAST, 0.005)
    away = np.abs(motion.inputs - motion.inputs[0]).max(axis=1)
    early, late = motion.t < 0.0, motion.t > FAST.end_time
    assert away[early].max() > 1.0
    assert away[late].max() > 1.0
    outside = (motion.t < -1.1 * motion.travel_time) | (motion.t > FAST.end_time + 1.1 * motion.travel_time)
    assert away[outside].max() < 1e-3
    sag = (motion.position[-1, 0] - motion.position[0, 0])[-1]
    assert sag == pytest.approx(8.0 * (1 + VALUES["gravity"] * 104.0 / VALUES["rope_stiffness"]), rel=1e-9)


def test_within_the_motion_lumped_ropes_converge_to_the_marched_one_with_the_square_of_an_element() -> None:
    motion = marched()
    inside = np.flatnonzero((motion.t > 0.5) & (motion.t < 5.5))[::20]
    errors = []
    for elements in (4, 8, 11):
        exact = heavy_rope(elements).with_reference(SMOOTH).exact(motion.t[inside])
        errors.append(np.abs(np.column_stack([exact["F_x"], exact["F_z"]]) - motion.inputs[inside]).max())
    assert errors[0] / errors[1] == pytest.approx((8 / 4) ** 2, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx((11 / 8) ** 2, rel=0.05)


@pytest.mark.parametrize("finest", thinned((16, 64), lambda finest: finest == 16))
def test_the_stray_of_the_plant_falls_with_the_square_of_an_element(finest: int) -> None:
    counts = [count for count in (8, 16, 32, 64) if count <= finest]
    strays = [stray(elements, SMOOTH, VALUES, marched(), 0.04 / finest) for elements in counts]
    assert np.log2(np.divide(strays[:-1], strays[1:])) == pytest.approx(2.0, abs=0.25)


def random_case(seed: int) -> tuple[sc.Reference, dict[str, float]]:
    """Draw a crane, a rope and a path with jerks of a crane's kind, in a plane or in space."""
    random = np.random.default_rng(seed)
    dimension = 2 + seed % 2
    length = random.uniform(3.0, 20.0)
    values = VALUES | {
        "trolley_mass": random.uniform(5.0, 500.0), "load_mass": random.uniform(20.0, 1000.0), "rope_length": length,
        "rope_mass": random.uniform(0.1, 3.0), "rope_stiffness": 10 ** random.uniform(5.3, 7.0),
    }  # fmt: skip
    way = np.append(random.uniform(-6.0, 6.0, dimension - 1), random.uniform(-2.0, 2.0))
    start = np.append(np.zeros(dimension - 1), -length)
    duration = random.uniform(1.0, 1.8) * 2 * np.pi * np.sqrt(length / VALUES["gravity"])
    return sc.rest_to_rest(tuple(start), tuple(start + way), duration, polynomial(13)), values


@pytest.mark.parametrize("seed", thinned(range(24), lambda seed: seed == 1))
def test_the_load_stays_within_a_tenth_of_a_millimetre_on_64_elements(seed: int) -> None:
    path, values = random_case(seed)
    assert stray(64, path, values, march_rope(path, values, 0.01), 0.004) < 1e-4


def test_without_its_mass_the_rope_s_inputs_lead_the_load_astray() -> None:
    half = VALUES["rope_mass"] * VALUES["rope_length"] / 2
    shared = VALUES | {"rope_mass": 0.0, "load_mass": 100.0 + half, "trolley_mass": 10.0 + half}
    strays = [stray(16, SMOOTH, VALUES, motion, 0.005) for motion in (marched(), march_rope(SMOOTH, shared, 0.01))]
    assert strays[1] > 100 * strays[0]


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        (STEPPY, "need the path's derivative of order 3, but .* 2 only: .* degree 7"),
        (sc.rest_to_rest((0.0, -8.0), (0.0, -20.0), 1.5), r"slack at t = 0\.\d+ s, 0 m above the load"),
        (sc.rest_to_rest((0.0,), (1.0,), 4.0), "2 or 3 components, not 1"),
        (polynomial_path([[0.0, -8.0], [1.0, 0.0]]), "still moves at t = -1 s"),
    ],
)  # fmt: skip
def test_paths_that_no_rope_can_follow_are_refused(path: sc.Reference, sentence: str) -> None:
    with pytest.raises(sc.InvalidReference, match=sentence):
        march_rope(path, VALUES)


def test_a_massless_rope_needs_one_derivative_more() -> None:
    path = sc.rest_to_rest((0.0, -8.0), (1.0, -8.0), 4.0, sc.DEGREE7)
    assert march_rope(path, VALUES).inputs.shape[1] == 2
    with pytest.raises(sc.InvalidReference, match=r"without mass need the path's derivative of order 4, .* degree 9"):
        march_rope(path, VALUES | {"rope_mass": 0.0})


@pytest.mark.parametrize(
    ("step", "sentence"),
    [(0.0, "not 0"), (1e-7, "1 pieces"), (2e-4, "for memory"), (2.0, "too long"), (0.1, "rope_mass of .* not -1")],
)
def test_steps_and_values_that_fit_no_march_are_refused(step: float, sentence: str) -> None:
    with pytest.raises(sc.InvalidSetting, match=sentence):
        march_rope(SMOOTH, VALUES | {"rope_mass": -1.0} if sentence.startswith("rope") else VALUES, step)


def test_a_rope_that_stretches_to_several_times_its_length_is_marched_in_shorter_pieces() -> None:
    motions = [march_rope(SMOOTH, VALUES | {"rope_stiffness": 50.0}, step) for step in (0.02, 0.01)]
    one, other = (CubicSpline(each.t, each.inputs)(np.linspace(0.0, 6.0, 61)) for each in motions)
    assert np.abs(one - other).max() < 1e-6 * np.abs(other).max()


@pytest.mark.parametrize(
    ("elements", "reason"),
    thinned([(6, "too long expressions"), (12, "symbols for 24 only")], lambda each: each[0] == 12),
)
def test_fine_ropes_are_plants_and_their_inversion_is_refused(elements: int, reason: str) -> None:
    with pytest.raises(sc.InvalidModel, match=f"{reason}: .* it can be simulated"):
        sc.solve(heavy_rope(elements))


@pytest.mark.parametrize("settings", [(0, 2), (2, 4)])
def test_ropes_without_elements_or_of_another_dimension_are_refused(settings: tuple[int, int]) -> None:
    with pytest.raises(sc.InvalidModel, match=r"element|2 or 3 dimensions"):
        heavy_rope(*settings)
