"""Certificates: right motions are proved with the truth inside, wrong ones never, and a cause is told."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest
import test_meeting_branches as meeting
from forty_digits import Digits, exactly
from numpy.polynomial import Polynomial
from outside.test_kinks import STRIKES, linear, two_cars
from outside.test_steps import HARMLESS, REFUSED, car
from present import present
from thinned import thinned

import servocore as sc
from benchmarks.atlas.row06_singular_configurations import near_horizontal, near_slack
from servocore.certificate import proof
from servocore.certificate.certify import Certificate
from servocore.certificate.proof import Proof
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.profiles import DEGREE3, DEGREE5, DEGREE7, DEGREE9
from servocore.references.rest_to_rest import RestToRest

INTERNAL = ["mass_on_car", "passive_joint_arm", "loop_manipulator"]
FLAT = [(name, model) for name, make in sc.scenes.REGISTRY.items() for model in make().models if name not in INTERNAL]


def require_truth_inside(scene: sc.Scene, certificate: Certificate, seed: int = 0) -> float:
    """Return the largest error bound, of a peak.

    Closed forms of forty digits: a result that is rounded to a double is off by a unit of that.
    """
    path, values = scene.reference, {name: cast("float", Digits(k)) for name, k in scene.parameter_values().items()}
    t = np.random.default_rng(seed).uniform(path.start_time, path.end_time, 20)
    exact = present(scene.closed_form)(path._derivatives(exactly(t), scene.closed_form_order), values)
    tube = certificate.tube(t)
    for name, bound in certificate.error_bounds.items():
        unit = 0.0 if exact[name].dtype == object else 2e-16 * bound.peak
        for value, (low, high) in zip(exact[name], tube[name], strict=True):
            assert low - unit <= value <= high + unit, name
    return max(bound.relative for bound in certificate.error_bounds.values())


def varied(scene: sc.Scene, rng: np.random.Generator) -> sc.Scene:
    path = scene.reference
    assert isinstance(path, RestToRest)
    ends = np.array([path.start, path.end])
    start, end = ends + rng.uniform(-0.3, 0.3, ends.shape) * np.maximum(np.abs(ends[1] - ends[0]), 0.1)
    way = sc.rest_to_rest(start, end, path.duration * rng.uniform(0.7, 1.5), path.profile)
    values = {k: v * rng.uniform(0.7, 1.4) for k, v in scene.parameter_values().items() if k != "gravity"}
    return scene.with_reference(way).with_parameters(**values)


@pytest.mark.parametrize(
    ("name", "model", "count", "most"),
    thinned(
        [*((*each, 1, 1e-9) for each in FLAT), ("overhead_crane", "points", 6, 1e-9),
         *((*each, 51, 1e-7) for each in FLAT if hasattr(sc.scenes.REGISTRY[each[0]]().reference, "profile"))],
        lambda case: case[2] < 50 and case[1] != "bodies"),
)  # fmt: skip
def test_flat_scenes_are_proved_on_their_and_on_random_paths_with_the_closed_form_inside(
    name: str, model: str, count: int, most: float
) -> None:
    scene, rng, verdicts, bounds = sc.scenes.REGISTRY[name](), np.random.default_rng(1), list[str](), [0.0]
    for seed in range(count):
        subject = varied(scene, rng) if seed else scene
        certificate = sc.certify(subject, model=model)
        verdicts.append(certificate.verdict)
        if certificate.error_bounds and subject.closed_form is not None:
            bounds.append(require_truth_inside(subject, certificate, seed))
    assert np.median(bounds) <= 1e-9
    assert max(bounds) <= most
    assert verdicts.count("undecided") <= 0.03 * count, verdicts
    assert verdicts.count("refuted") <= 0.1 * count, verdicts


# Bad cases ------------------------------------------------------------------------------------------------------------

CRANE, OVERHEAD = sc.scenes.rotary_crane(), sc.scenes.overhead_crane()
QUADROTOR = sc.scenes.quadrotor_with_load()


def line(
    scene: sc.Scene, start: tuple[float, ...], end: tuple[float, ...], duration: float, **more: object
) -> sc.Scene:
    return scene.with_reference(sc.rest_to_rest(start, end, duration, **more))  # type: ignore[arg-type]  # of rest_to_rest


SPIKED = line(QUADROTOR, tuple(QUADROTOR.reference.jet(0.0, 0)[0]), (5.91, 2.15), 1.71, profile=sc.DEGREE13)


def unsteady() -> sc.Scene:
    system = car().model()
    return replace(car(), models={"only": lambda: replace(system, force=ca.if_else(ca.fmod(system.q, 0.3), 1.0, 2.0))})


BAD: dict[str, tuple[Callable[[], sc.Scene], str]] = {
    "a force without a bound of its jumps": (unsteady, "at every instant"),
    "above the girder": (lambda: line(OVERHEAD, (0, -1), (1, 1), 5.0), "girder|singular"),
    "a rough path": (lambda: line(sc.scenes.cars(), (0,), (1,), 3.0, profile=DEGREE5), "velocities jump at t = 0 s"),
    "a broken rate": (lambda: OVERHEAD.with_limits(**{"F.rate": 1000.0}), "F.rate"),
    **{kind: (make, "") for kind, (make, _) in REFUSED.items()},
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_never_proved_and_a_cause_is_told(case: str) -> None:
    make, cause = BAD[case]
    certificate = sc.certify(make())
    assert certificate.verdict != "proved"
    told = " ".join(str(each) for each in certificate.statements if each.verdict != "proved")
    assert re.search(cause, told), told


@pytest.mark.parametrize("kind", ["a stop", "dry friction", "a corner", "a support that turns back"])
def test_a_motion_that_the_equations_let_jump_is_refuted_with_the_time(kind: str) -> None:
    make, words = STRIKES[kind]
    told = str(sc.certify(make()))
    (time,), (expected,) = (re.findall(r"t = (\S+) s .* would", each.replace("\\", "")) for each in (told, words))
    assert float(time) == pytest.approx(float(re.sub(r"d\*", "", expected)), abs=2e-5)


@pytest.mark.parametrize(("energy", "friction"), [
    (linear, lambda speed: 2.0 * ca.tanh(speed / 0.05)),
    (lambda s: linear(s) + 2000 * ca.fmax(0, s - 0.01) ** 4, lambda speed: 2.0 * speed),
], ids=["friction", "stop"])  # fmt: skip
def test_smooth_friction_is_no_kink_and_a_stop_that_hardens_smoothly_lets_nothing_jump(
    energy: Callable[[ca.SX], ca.SX], friction: Callable[[ca.SX], ca.SX]
) -> None:
    assert sc.certify(two_cars(energy, friction, False)).verdict == "proved"


def test_a_proof_finds_the_branch_that_a_run_of_many_instants_misses() -> None:
    """Finding: 100 to 400 steps jump to the other assembly without a word."""
    certificate = sc.certify(meeting.scene(longer=1e-6), tolerance=1e-4)
    found = {each.what: each.verdict for each in certificate.statements}
    assert found["one branch from the beginning to the end"] == "proved"
    low, high = certificate.tube([4.0])["y2"][0]
    assert low - 5e-10 <= 0.11446253077 <= high + 5e-10
    assert high - low < 1e-9


@pytest.mark.parametrize("model", thinned(QUADROTOR.models, lambda model: model == "points"))
def test_a_spike_between_instants_is_refuted_with_its_value(model: str) -> None:
    """Finding: the thrust turns fast between two of 201 instants, which show a quarter of the moment."""
    exact = np.abs(SPIKED.exact(np.linspace(0.0, 1.71, 20_001))["M"]).max()
    statements = sc.certify(SPIKED, model=model, tolerance=1e-4).statements
    statement = next(each for each in statements if each.verdict == "refuted")
    assert statement.what.startswith("M between instants")
    assert statement.time == pytest.approx(0.288, abs=1e-3)
    assert float(statement.sentence.split()[2]) == pytest.approx(exact, rel=1e-2)


def test_a_pole_that_no_proof_passes_is_refuted_by_what_is_joined_before_it() -> None:
    """A rope that nearly goes slack is 8,500 km long there."""
    scene = near_slack(1e-6)
    with pytest.warns(sc.ServocoreWarning):
        solution = sc.solve(
            scene, sc.Reduced(), sc.BackwardEuler(), step=scene.reference.duration / 200, model="generalized"
        )
    certificate = sc.certify(solution, tolerance=0.05)
    statement = next(each for each in certificate.statements if each.verdict == "refuted")
    time = present(statement.time)
    assert statement.what.startswith("M_b between instants")
    value = float(statement.sentence.split()[2])
    assert value == pytest.approx(scene.exact(np.array([time]))["M_b"][0], rel=1e-3)
    assert abs(value) > 2.0 * np.abs(solution["M_b"]).max()
    assert np.isfinite(certificate.tube([time])["M_b"]).all()
    assert np.isinf(certificate.tube([scene.reference.end_time])["M_b"]).all()  # perhaps of another branch


NEAR_POLES = ((near_slack, 1e-4), *((near_horizontal, angle) for angle in (1.0, 0.5, 0.2)))


@pytest.mark.parametrize(("approach", "distance"), NEAR_POLES)
@pytest.mark.parametrize("most", [60, pytest.param(proof._MOST, marks=pytest.mark.nightly)])
def test_a_pole_is_refuted_in_its_step_though_a_winch_turns_too_far_for_the_whole_run(
    approach: Callable[[float], sc.Scene], distance: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(proof, "_MOST", most)
    scene = approach(distance)
    step = scene.reference.duration / 200
    with pytest.warns(sc.ServocoreWarning):
        solution = sc.solve(scene, sc.Reduced(), sc.BackwardEuler(), step=step, model="bodies")
    statement = next(each for each in sc.certify(solution, tolerance=0.05).statements if each.verdict == "refuted")
    name, time = statement.what.split()[0], present(statement.time)
    value = float(statement.sentence.split()[2])
    assert value == pytest.approx(scene.exact(np.array([time]))[name][0], rel=1e-3)
    assert abs(value) > 2.0 * np.abs(solution[name]).max()


def test_inputs_that_jump_are_listed_and_the_motion_is_proved() -> None:
    for scene, start, end in ((OVERHEAD, (0.0, -4.0), (5.0, -1.0)), (sc.scenes.cars(), (0.0,), (1.0,))):
        certificate = sc.certify(line(scene, start, end, 3.0, profile=DEGREE7))
        assert (certificate.verdict, certificate.jumps) == ("proved", (0.0, 3.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Bumped(Reference):
    """A path of polynomials of degree 12 whose velocity jumps in the middle."""

    base: sc.Reference
    jump: float

    @property
    def joints(self) -> np.ndarray:
        return np.linspace(self.start_time, self.end_time, 3)

    @property
    def degree(self) -> int:
        return 12

    def _derivatives(self, t: np.ndarray, order: int) -> np.ndarray:
        found, half = self.base.jet(t, order).copy(), self.duration / 2.0
        late = (t >= half) & (t < self.end_time)
        bump = Polynomial([0.0, self.jump]) * Polynomial([1.0, -1.0 / half]) ** 10
        for k in range(order + 1):
            found[late, k, 0] += bump.deriv(k)(t[late] - half)
        return found


@pytest.mark.parametrize(("jump", "verdict"), [(1e-6, "refuted"), (1e-9, "proved")])
def test_a_velocity_of_a_path_jumps_if_it_does_so_by_more_than_rounding(jump: float, verdict: str) -> None:
    """Of a peak of 4 m/s, in a path that is not said to be smooth."""
    base = sc.rest_to_rest((0.0, -4.0), (5.0, -1.0), 3.0)
    path = Bumped(start_time=0.0, end_time=3.0, dimension=2, max_order=99, smoothness=0, base=base, jump=jump)
    found = sc.certify(OVERHEAD.with_reference(path))
    assert found.verdict == verdict, found
    assert ("velocities jump at t = 1.5 s" in str(found)) is (verdict == "refuted")


TURNS = np.linspace(0.0, 4.0 * np.pi, 40)
CIRCLE = np.column_stack([3.0 * np.cos(TURNS), 3.0 * np.sin(TURNS), np.full(40, -4.0)])


def test_a_fitted_path_does_not_jump_where_a_component_rests() -> None:
    assert sc.certify(CRANE.with_reference(sc.sampled(np.linspace(0.0, 60.0, 40), CIRCLE))).jumps == ()


@pytest.mark.parametrize(("model", "verdict"), [("points", "undecided"), ("generalized", "proved")])
def test_an_angle_by_its_direction_is_known_up_to_whole_turns(model: str, verdict: str) -> None:
    """It goes on from 135 to 236 degrees, within limits."""
    around = line(CRANE, (-2.0, 2.0, -4.0), (-2.0, -3.0, -3.0), 12.0)
    found = sc.certify(around, {"phi": ("100 deg", "240 deg")}, model=model)
    assert [each.verdict for each in found.statements if each.what == "limit of phi"] == [verdict]
    assert ("known up to whole turns" in str(found)) is (verdict == "undecided")


def test_nothing_is_asked_of_a_motion_beyond_the_ends_of_its_path() -> None:
    """The rope would go slack within a hundredth of the duration."""
    t = np.linspace(0.0, 1.0, 60)
    path = sc.sampled(t, np.column_stack([t, -1.0 - 0.98 * 9.81 * t**6 / 30.0]))
    assert sc.certify(OVERHEAD.with_reference(path)).verdict == "proved"


def rubbing() -> sc.Scene:
    """A car that is pushed there and back against dry friction."""
    scene = car(lambda x: x)
    system = scene.model()
    system = replace(system, force=-5 * ca.sign(system.v))
    return sc.Scene("car", {"only": lambda: system}, sc.through([(0.0,), (1.0,), (0.0,)], duration=3.0))


@pytest.mark.parametrize(
    ("make", "times"), [(rubbing, [0.0, 1.5, 3.0]), (HARMLESS["a potential with a kink, no step"], [0.918])]
)
def test_equations_that_jump_in_inputs_alone_are_proved_with_the_times(
    make: Callable[[], sc.Scene], times: list[float]
) -> None:
    scene = make()
    certificate = sc.certify(sc.solve(scene, step=0.01))
    assert certificate.verdict == "proved", certificate
    assert certificate.jumps == pytest.approx(times, abs=2e-3)
    assert certificate.error_bounds["F"].relative < 1e-9
    low, high = certificate.tube([times[-1]])["F"][0]
    assert 10.0 <= high - low < 10.11  # the force jumps from -5 N to 5 N more
    assert sc.certify(scene, {"F.rate": 1e6}).verdict == "undecided"


def with_friction(path: np.ndarray, values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Inputs of the overhead crane, and friction by hand: the trolley is `lift` times the pull above the load."""
    load, speed, pull, jerk = np.moveaxis(path[:, :4].copy(), 1, 0)
    pull[:, 1] = pull[:, 1] + values["gravity"]
    lift, size = -load[:, 1] / pull[:, 1], np.hypot(*pull.T)
    rise = -(speed[:, 1] + lift * jerk[:, 1]) / pull[:, 1]
    answer = present(OVERHEAD.closed_form)(path, values)
    winch = values["winch_friction"] * values["winch_radius"]
    for name, rate, dry in (
        ("F", speed[:, 0] + rise * pull[:, 0] + lift * jerk[:, 0], values["trolley_friction"]),
        ("M_w", rise * size + lift * (pull * jerk).sum(axis=1) / size, winch),
    ):
        answer[name] = answer[name] + dry * (np.tanh(rate / values["creep"]) + values["viscous_share"] * rate)
    return answer


@pytest.mark.parametrize("seed", thinned(range(20), lambda seed: seed < 2))
def test_friction_by_chance_leaves_bounds_narrow_with_the_closed_form_inside(seed: int) -> None:
    scene, rng = OVERHEAD.with_effects("friction"), np.random.default_rng(seed)
    changed = {k: x * rng.uniform(0.2, 3.0) for k, x in scene.parameter_values().items() if "friction" in k}
    scene = replace(scene.with_parameters(**changed, creep=10.0 ** rng.uniform(-2.7, -1.0)), closed_form=with_friction)
    certificate = sc.certify(scene)
    assert certificate.verdict == "proved", certificate
    assert require_truth_inside(scene, certificate, seed) < 5e-9
    assert max(each.between / each.peak for each in certificate.error_bounds.values()) < 5e-9


def test_disturbed_answers_are_never_proved_without_the_truth_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, rng = Problem.of(OVERHEAD), np.random.default_rng(2)
    exact = Proof(problem, {}, 1e-8)
    interpolated = Proof._interpolated
    for size in 10.0 ** np.arange(-12.0, 0.0):

        def disturbed(self: Proof, x: np.ndarray, size: float = size) -> np.ndarray:
            return interpolated(self, x * (1.0 + size * rng.normal(size=x.shape[1:])))

        monkeypatch.setattr(Proof, "_interpolated", disturbed)
        monkeypatch.setattr(proof, "_MOST", 60)
        tried = Proof(problem, {}, 1e-8)
        monkeypatch.undo()
        right, own = exact.at(exact.x, tried.begin), tried.proved & tried.within
        off = np.abs(tried.ring.ends(tried.x)[0][0] - right[0])
        assert (off <= tried.x[-1] + right[1])[:, own].all(), size


# Solutions, parameters ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", thinned(["overhead_crane", *INTERNAL], lambda name: name != "loop_manipulator"))
def test_inputs_of_a_solution_are_compared_with_the_proved_ones(name: str) -> None:
    scene = sc.scenes.REGISTRY[name]()
    assert sc.certify(sc.solve(scene)).verdict == "proved"
    stepped = sc.solve(scene, sc.Projected(), sc.BackwardEuler(), step=0.01)
    certificate, exact = sc.certify(stepped), scene.exact(stepped.t)
    assert certificate.verdict == "refuted"
    for each, bound in certificate.error_bounds.items():
        assert bound.at_instants == pytest.approx(np.abs(stepped[each] - exact[each]).max(), rel=1e-6)


def test_coordinates_of_a_solution_are_compared_with_the_proved_ones() -> None:
    solution = sc.solve(OVERHEAD)
    values = solution.values.copy()
    values[7, solution.names.index("s")] += 1e-6
    assert "s is off by at most" in sc.certify(replace(solution, values=values)).summary


def test_a_solve_refuses_what_its_certificate_refutes_and_warns_of_what_it_leaves_undecided() -> None:
    assert sc.solve(OVERHEAD.with_limits(F=511.0), certify=True).t[-1] == 3.0
    with pytest.raises(sc.InvalidReference, match=r"certificate is refuted: inputs and coordinates within 0\.05 of"):
        sc.solve(OVERHEAD, sc.Projected(), sc.BackwardEuler(), step=0.05, certify=True)
    with pytest.warns(sc.ServocoreWarning, match=r"certificate is undecided: one motion .*inputs within"):
        sc.solve(sc.scenes.mass_on_car().with_parameters(stiffness=-5.0), step=0.2, certify=True)


def test_a_solution_that_passes_a_singular_configuration_is_refuted_with_the_instants_beside_it() -> None:
    singular = r"one motion.* is singular between t = 2\.58 s and 2\.6 s"
    with pytest.warns(match="lose rank"), pytest.raises(sc.InvalidReference, match=singular):
        sc.solve(meeting.scene(guess="crossed after"), certify=True)


@pytest.mark.parametrize(("scene", "name"), [(CRANE, "M_b"), (OVERHEAD, "F")], ids=["rotary", "overhead"])
def test_limits_hold_for_all_parameters_of_a_box_or_are_refuted_with_one(scene: sc.Scene, name: str) -> None:
    t, masses = np.linspace(0.0, scene.reference.duration, 2001), np.linspace(50.0, 150.0, 21)
    peak = max(np.abs(scene.with_parameters(load_mass=m).exact(t)[name]).max() for m in masses)
    box = {"load_mass": (50.0, 150.0)}
    kept = sc.certify(scene, limits={name: 1.001 * peak}, parameters=box)
    assert kept.verdict == "proved", kept
    for mass in (50.0, 83.0, 150.0):
        low, high = kept.tube(t)[name].T
        exact = scene.with_parameters(load_mass=mass).exact(t)[name]
        assert ((low <= exact) & (exact <= high)).all()
    broken = sc.certify(scene, limits={name: 0.95 * peak}, parameters=box)
    assert broken.verdict == "refuted"
    assert "load_mass = " in str(broken)


@pytest.mark.parametrize(
    ("name", "seed"), thinned([(name, k) for name in INTERNAL for k in range(10)], lambda case: case[1] == 0)
)
def test_internal_dynamics_have_the_motion_from_their_start_inside(name: str, seed: int) -> None:
    """Random parameters and durations against SciPy's integration of the scene's own equations at rtol = 1e-13."""
    scene, rng = sc.scenes.REGISTRY[name](), np.random.default_rng(seed)
    path = cast("RestToRest", scene.reference)
    way = sc.rest_to_rest(path.start, path.end, path.duration * rng.uniform(0.8, 2.0), path.profile)
    values = {k: v * rng.uniform(0.9, 1.1) for k, v in scene.parameter_values().items()}
    scene = scene.with_reference(way).with_parameters(**values)
    certificate = sc.certify(sc.solve(scene), tolerance=1e-6)
    assert certificate.verdict == "proved", certificate
    assert "logarithmic norm from -" in str(certificate)
    t = np.linspace(path.start_time, scene.reference.end_time, 100)
    exact, tube = scene.exact(t), certificate.tube(t)
    for each in certificate.error_bounds:
        (low, high), unit = tube[each].T, 2e-12 * np.abs(exact[each]).max()
        assert ((low - unit <= exact[each]) & (exact[each] <= high + unit) & (high - low < 1e5 * unit)).all()


@pytest.mark.parametrize(("step", "profile"), [(0.5, DEGREE9), (0.02, DEGREE3)])
def test_internal_dynamics_of_coarse_solutions_and_of_paths_with_jumps_start_at_rest(
    step: float, profile: sc.Profile
) -> None:
    scene = line(sc.scenes.mass_on_car(), (0,), (1,), 4.0, profile=profile)
    solution = sc.solve(scene, step=step, checks=False)
    certificate, exact = sc.certify(solution), scene.exact(solution.t)["u"]
    bound = certificate.error_bounds["u"]
    assert certificate.jumps == ((0.0, 4.0) if profile is DEGREE3 else ())
    assert bound.at_instants == pytest.approx(np.abs(solution["u"] - exact).max(), rel=1e-6)


def test_a_motion_from_a_start_that_is_no_equilibrium_is_proved_from_there() -> None:
    arm = Path(__file__).parent / "mechanisms" / "arm.urdf"
    solution = sc.solve(sc.scenes.from_file(arm, passive=["elbow"], limits=False))  # which begins to fall
    assert sc.certify(solution).verdict == "proved"


@pytest.mark.parametrize(("step", "within"), [(0.02, 1e-7), (0.2, 1e-5)])
def test_without_a_bound_of_internal_states_equations_are_proved_at_the_computed_ones(
    step: float, within: float
) -> None:
    """A mass that its support pushes away: the bounded motion is no motion that a start determines."""
    scene = sc.scenes.mass_on_car().with_parameters(stiffness=-5.0)
    solution = sc.solve(scene, step=step)

    def stated(solution: sc.Solution) -> float:
        motion, algebraic, limit = sc.certify(solution, {"u": 1e6}).statements
        assert [each.verdict for each in (motion, algebraic, limit)] == ["undecided", "proved", "undecided"]
        assert "logarithmic norm from 1.79 to 1.79 1/s no bound of their error is known from t = -" in str(motion)
        return float(re.findall(r"within (\S+) of", algebraic.sentence)[0])

    assert stated(solution) < within
    values = solution.values.copy()
    values[50, solution.names.index("u")] += 0.01 * np.abs(solution["u"]).max()
    assert stated(replace(solution, values=values)) == pytest.approx(0.01, rel=0.01)


def test_a_limit_that_internal_dynamics_break_is_refuted_with_the_time() -> None:
    solution = sc.solve(sc.scenes.mass_on_car())
    peak, at = np.abs(solution["u"]).max(), solution.t[np.abs(solution["u"]).argmax()]
    broken = sc.certify(solution, {"u": 0.9 * peak}).summary
    assert float(re.findall(r"t = (\S+) s", broken)[0]) == pytest.approx(at, abs=0.05)


def test_a_box_is_not_proved_by_equations_that_hold_at_the_values_of_the_scene_alone() -> None:
    """A damper between two cars, of which the second follows a path: without it there are no internal dynamics."""
    system = two_cars(linear, lambda _: ca.SX(0), False).model()
    damper = sc.Parameters(sc.Parameter("d", 0.0, "N.s/m", 0.0, 10.0, "damper"))
    force = damper["d"] * (system.v[1] - system.v[0])
    damped = replace(system, parameters=damper, force=system.force + ca.vertcat(force, -force))
    scene = sc.Scene("damped", {"only": lambda: damped}, sc.rest_to_rest((0.0,), (1.0,), 2.0))
    assert sc.certify(scene).verdict == "proved"
    assert sc.certify(scene, parameters={"d": (0.0, 1.0)}).verdict == "undecided"


def test_what_cannot_be_certified_is_told() -> None:
    scene = sc.scenes.mass_on_car()
    assert "undecided: one motion (the states of the internal dynamics" in str(sc.certify(scene))
    assert "rates of inputs are not enclosed" in str(sc.certify(sc.solve(scene), {"u.rate": 1e6}))
    assert "for a box of parameters is not known" in str(sc.certify(sc.solve(scene), parameters={"mass": (1.9, 2.1)}))


@pytest.mark.parametrize(("given", "said"), [
    ({"parameters": {"mass": (1.0, 2.0)}}, "no parameter mass; there are"),
    *(({"parameters": {"load_mass": each}}, "must run from a lower") for each in ((2.0, 1.0), 5.0, (1.0,))),
    *(({"parameters": {"load_mass": each}}, "outside its range") for each in ((-1.0, 1.0), (1.0, np.inf))),
    ({"parameters": ["load_mass"]}, "intervals by name"), ({"limits": "F"}, "bounds by name"),
    ({"limits": {1: 5.0}}, "nothing called 1"), ({"tolerance": 0.0}, "positive"), ({"tolerance": np.nan}, "positive"),
])  # fmt: skip
def test_what_is_no_question_to_a_certificate_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(sc.ServocoreError, match=said):
        sc.certify(OVERHEAD, **given)


def test_what_is_no_question_to_a_solution_a_tube_or_a_plot_is_refused() -> None:
    solution, certificate = sc.solve(OVERHEAD, step=0.5), sc.certify(OVERHEAD)
    for question, said in (
        (lambda: sc.certify(solution, model="points"), "has its own model"),
        (lambda: sc.certify(replace(solution, t=solution.t[:0])), "finite instants"),
        (lambda: certificate.tube(np.nan), "one row of finite numbers"),
        (lambda: certificate.plot([]), "a list of one name or more"),
        (lambda: certificate.plot(["Q"]), "reports nothing called Q"),
    ):
        with pytest.raises(sc.ServocoreError, match=said):
            question()


def test_a_limit_of_a_rate_is_undecided_where_the_path_has_derivatives_for_the_inputs_only() -> None:
    path = replace(sc.periodic((2.5, -3.0), [[0.2, 0.1]], [[0.1, 0.1]], 5.0), max_order=4)
    found = sc.certify(OVERHEAD.with_reference(path), {"F.rate": 1e6, "s.rate": 100.0})
    failing = {each.what: each.verdict for each in found.statements if each.verdict != "proved"}
    assert failing == {"limit of F.rate": "undecided"}


def test_a_mass_that_is_negative_beside_constraints_is_not_refuted() -> None:
    """The motion on which it is negative may be one that they exclude; families refute negative masses without them."""
    system = OVERHEAD.model()
    away = ca.sumsqr(system.q - system.home_configuration()[0])
    worse = replace(system, mass=system.mass * (1.0 - 2.0 * away / (away + 1e-3)))
    found = sc.certify(replace(OVERHEAD, models={"worse": lambda: worse}))
    failing = [each.what.split(" ")[0] for each in found.statements if each.verdict != "proved"]
    assert (failing, found.verdict) == (["mass"], "undecided")


def test_a_certificate_is_short_in_print_has_a_plot_and_knows_nothing_of_times_far_from_the_path() -> None:
    certificate = sc.certify(OVERHEAD)
    assert repr(certificate).startswith("<Certificate of overhead_crane: proved, ")
    assert len(certificate.plot(["F"]).axes[0].lines) == 2
    assert np.isfinite(certificate.tube([-9.0, 1.0, 9.0])["F"]).all(axis=1).tolist() == [False, True, False]
