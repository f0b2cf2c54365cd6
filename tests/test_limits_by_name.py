"""Limits by name are kept at all times, and a motion that breaks one is refused with name, value, limit and time."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import casadi as ca
import numpy as np
import pytest
import scipy.interpolate
from command_lines import write
from outside.writing import coordinates, lagrange
from present import present
from thinned import thinned

import servocore as sc
from servocore.numerics.units import in_unit
from servocore.rotationless import GROUND, Assembly, PointMass, distance, rope

SAID = re.compile(
    r"at t = (?P<time>\S+) s (?P<name>.+) goes beyond its (?P<side>lower|upper) limit of (?P<bound>\S+) (?P<unit>\S+);"
    r" it reaches (?P<value>\S+) \S+ at t = (?P<worst>\S+) s"
)
CRANE = sc.scenes.rotary_crane()


def refusal(scene: sc.Scene, model: str | None = None) -> dict[str, str] | None:
    """Return what `solve` says of a broken limit, or None; `ExactInversion` says the same."""
    said = []
    for run in (sc.solve, sc.ExactInversion):
        try:
            run(scene, model=model)
        except sc.InvalidReference as error:
            said.append(str(error))
        else:
            said.append("")
    found, other = (SAID.search(each) for each in said)
    assert bool(found) == bool(said[0]) == bool(other), said
    if found is None or other is None:
        return None
    for name, each in other.groupdict().items():  # each looks from instants of its own
        assert each == found[name] or float(each) == pytest.approx(float(found[name]), rel=1e-4), said
    return found.groupdict()


def random_crane(seed: int) -> tuple[sc.Scene, np.random.Generator]:
    """Return a crane with data of its own on a line of its own, quick enough to swing."""
    random = np.random.default_rng(seed)
    scene = (sc.scenes.rotary_crane, sc.scenes.overhead_crane, sc.scenes.gantry_crane)[seed % 3]()
    scene = scene.with_parameters(
        load_mass=random.uniform(20, 400), trolley_mass=random.uniform(5, 80), winch_inertia=random.uniform(0.01, 1)
    )
    level = random.uniform(2.0, 6.0, (2, len(scene.model().outputs) - 1))
    ends = np.column_stack([level, random.uniform(-6.0, -2.0, 2)])
    return scene.with_reference(sc.rest_to_rest(ends[0], ends[1], random.uniform(4.0, 12.0), sc.DEGREE13)), random


class TestRandomCranes:
    """The closed form on 20,001 instants says whether and when a limit is broken."""

    @pytest.mark.parametrize("seed", range(18))
    def test_a_limit_is_broken_where_the_closed_form_says_so_and_nowhere_else(self, seed: int) -> None:
        scene, random = random_crane(seed)
        t = np.linspace(0.0, scene.reference.duration, 20_001)
        exact, inputs = scene.exact(t), [each.name for each in scene.model().inputs]
        name = random.choice([*inputs, "tension", "l"])
        values = exact[name]
        rate = bool(seed % 2)
        if rate:
            values = scipy.interpolate.make_interp_spline(t, values, k=5).derivative()(t)
        low, high = values.min(), values.max()
        share = random.choice([1.02, random.uniform(0.3, 0.98)])  # of the range about its middle
        lower, upper = (low + high) / 2 + np.array([-1, 1]) * share * (high - low) / 2
        limited = scene.with_limits(**{name + ".rate" * rate: (lower, upper)})
        found, bad = refusal(limited), np.flatnonzero((values < lower) | (values > upper))
        assert (found is None) == (not len(bad)) == (share > 1.0)
        if found is not None:
            first = bad[0]
            assert found["name"] == name + ".rate" * rate
            assert found["side"] == ("lower" if values[first] < lower else "upper")
            assert float(found["time"]) == pytest.approx(t[first], abs=1.5 * t[1])
            spell = bad[: np.argmax(np.diff([*bad, len(t) + 9]) > 1) + 1]
            peak = values[spell].min() if found["side"] == "lower" else values[spell].max()
            assert float(found["value"]) == pytest.approx(peak, rel=2e-4, abs=1e-4 * (high - low))
            assert float(found["bound"]) == pytest.approx(lower if found["side"] == "lower" else upper, rel=1e-5)

    @pytest.mark.parametrize("model", CRANE.models)
    def test_every_model_breaks_the_same_limit_at_the_same_time(self, model: str) -> None:
        tight = (CRANE.with_limits(**{name: bound}) for name, bound in (("M_b", 120), ("F.rate", 8)))
        found = [present(refusal(scene, model)) for scene in tight]
        assert [float(each["time"]) for each in found] == pytest.approx([11.7962, 11.8304], abs=2e-4)

    @pytest.mark.parametrize(
        ("share", "verdict"), thinned([(1.001, "proved"), (0.999, "refuted")], lambda case: case[1] == "refuted")
    )
    def test_a_peak_between_two_instants_of_any_grid_is_found(self, share: float, verdict: str) -> None:
        """Past the axis at 3 mm M_b has a peak of some 3 ms in 20 s, which 200 instants do not see."""
        scene = CRANE.with_reference(sc.rest_to_rest((5.0, 3e-3, -5.0), (-5.0, 3e-3, -5.0), 20.0))
        t = np.linspace(9.97, 10.03, 60_001)
        peak = np.abs(scene.exact(t)["M_b"]).max()
        coarse = np.abs(scene.exact(np.linspace(0.0, 20.0, 200))["M_b"]).max()
        assert peak > 10.0 * coarse
        with pytest.warns(sc.ServocoreWarning, match="passes close to a pole: at .* M_b is"):
            sc.solve(scene)
        found = sc.certify(scene, {"M_b": share * peak})
        (limit,) = (each for each in found.statements if each.what == "limit of M_b")
        assert limit.verdict == verdict

    def test_the_first_of_several_broken_limits_is_told(self) -> None:
        found = present(refusal(CRANE.with_limits(M_b=120, F=17, M_w=(-98.5, -97))))
        assert found["name"] == "M_w"
        assert {"name": "F", "unit": "N"}.items() <= present(refusal(CRANE.with_limits(M_b=120, F=17))).items()


class TestWhatALimitIs:
    def test_one_number_is_symmetric_and_an_upper_bound_for_what_is_never_negative(self) -> None:
        assert present(refusal(CRANE.with_limits(F=17)))["side"] == "lower"  # F runs from -17.6 to 2 N
        assert refusal(CRANE.with_limits(F=(None, 17))) is None
        limits = {each.quantity: each for each in CRANE.with_limits(swing=0.1, tension=1e3, l=9.0, F=1.0).limits[-4:]}
        assert [limits[name].bound for name in ("swing", "tension", "l", "F")] == [-np.inf, -np.inf, -np.inf, -1.0]
        assert CRANE.with_limits(**{"l.rate": 1.0}).limits[-1].bound == -1.0

    def test_a_limit_that_is_just_reached_is_kept(self) -> None:
        peak = np.abs(CRANE.exact(np.linspace(5.0, 7.0, 200_001))["F"]).max()
        assert refusal(CRANE.with_limits(F=peak * (1 + 1e-9))) is None
        assert present(refusal(CRANE.with_limits(F=peak * (1 - 1e-3))))["name"] == "F"
        assert sc.certify(CRANE, {"F": peak * (1 - 1e-6)}).verdict == "refuted"  # between two instants only

    def test_a_new_limit_takes_the_place_of_one_of_the_same_name_and_none_removes_it(self) -> None:
        tight = CRANE.with_limits(F=10, M_b=1000)
        assert refusal(tight) is not None
        assert refusal(tight.with_limits(F=20)) is None
        assert tight.with_limits(F=None, M_b=None).limits == CRANE.limits

    def test_an_angle_counts_its_turns(self) -> None:
        circle = sc.periodic((0.0, 0.0, -5.0), [[4.0, 0.0, 0.0]], [[0.0, 4.0, 0.0]], period=20.0, cycles=2)
        turning = CRANE.with_reference(circle)
        assert refusal(turning.with_limits(phi="725 deg")) is None
        found = present(refusal(turning.with_limits(phi="540 deg")))
        assert float(found["time"]) == pytest.approx(30.0, abs=1e-3)

    @pytest.mark.parametrize(
        ("text", "unit", "value"),
        [("5 deg", "rad", np.radians(5)), ("2 m/s", "m/s", 2.0), ("7.2 km/h", "m/s", 2.0), ("1e3mm", "m", 1.0),
         ("0.2 kN", "N", 200.0), ("3 kN.m/s", "N.m/s", 3e3), ("60 rpm", "rad/s", 2 * np.pi), ("1.5", "N", 1.5),
         ("4 J", "N.m", 4.0), ("2 m/s^2", "m/s2", 2.0), ("-90 deg/s", "rad/s", -np.pi / 2)],
    )  # fmt: skip
    def test_units_are_converted(self, text: str, unit: str, value: float) -> None:
        assert in_unit(text, unit, "it") == pytest.approx(value, rel=1e-14)

    @pytest.mark.parametrize(
        ("limits", "sentence"),
        [
            ({"swing": "5 m"}, "the limit of swing is given in m, but its unit is rad"),
            ({"s.rate": "5 m"}, "the limit of s.rate is given in m, but its unit is m/s"),
            ({"F": "60 lbf"}, "the limit of F is given in lbf, which is no unit known here: 1, %, m, "),
            ({"F": "6 MN^999"}, "the limit of F is given in MN^999, which is no unit known here: 1, %, m, "),
            ({"F": "much"}, "the limit of F is given as 'much', which is no number with a unit, such as '2 N'"),
            ({"F": (3, -3)}, "the limit of F must run from a lower to an upper number, not from 3 to -3"),
            ({"F": (None, None)}, "the limit of F must run from a lower to an upper number"),
            ({"F": (1, 2, 3)}, "the limit of F must be one number or a lower and an upper one, not (1, 2, 3)"),
            ({"F": float("nan")}, "the limit of F must be a number or a text with its unit, such as '2 N', not nan"),
            ({"F": sc}, "the limit of F must be a number or a text with its unit"),
            ({"phi": ("-170", "170")}, "the limit of phi is -170 without a unit: -170 rad would be -9740 deg"),
            ({"force": None}, "rotary crane, points reports nothing called force that could have a limit"),
            ({"force.rate": 60}, "rotary crane, points reports nothing called force.rate that could have a limit"),
        ],
    )
    def test_what_is_no_limit_gets_one_sentence(
        self, limits: dict[str, str | tuple[int | None, ...] | float | ModuleType], sentence: str
    ) -> None:
        with pytest.raises(sc.InvalidSetting) as refused:
            CRANE.with_limits(**limits)  # type: ignore[arg-type]  # wrong on purpose
        assert str(refused.value).startswith(sentence)

    def test_an_angle_has_its_unit_or_is_likely_to_be_in_radians(self) -> None:
        limits = CRANE.with_limits(swing="5 rad", phi=(-6.0, 6.0), **{"swing.rate": 5.0}).limits[-3:]
        assert [limit.upper for limit in limits] == [5.0, 6.0, 5.0]

    def test_a_rate_for_which_the_path_has_not_enough_derivatives_is_refused_with_both_orders(self) -> None:
        t = np.linspace(0.0, 20.0, 41)
        table = CRANE.reference.jet(t, 4)
        path = replace(CRANE.reference, max_order=4)
        assert table.shape == (41, 5, 3)
        short = CRANE.with_reference(path)
        assert refusal(short.with_limits(F=60, **{"s.rate": 1.2, "tension.rate": 100})) is None
        with pytest.raises(sc.InvalidReference, match=r"limit of F\.rate needs .* order 5, but .* up to order 4$"):
            sc.solve(short.with_limits(**{"F.rate": 100}))

    def test_the_rate_of_an_input_that_jumps_is_refused_with_the_order_that_jumps(self) -> None:
        rough = CRANE.with_reference(sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0, sc.DEGREE7))
        with pytest.raises(sc.InvalidReference, match=r"F\.rate cannot be kept: .* order 3 only, .* order 4 jumps"):
            sc.ExactInversion(rough.with_limits(**{"F.rate": 100}))
        with pytest.warns(sc.ServocoreWarning, match="the inputs jump"):
            assert refusal(rough.with_limits(**{"s.rate": 1.2})) is None


class TestExpressions:
    """A `Limit` takes any expression of q, v, lam, u and p, from both sides."""

    @staticmethod
    def limited(lower: float, upper: float) -> sc.Scene:
        def power(system: sc.MechanicalSystem) -> ca.SX:
            return system.u[1] * system.coordinates.velocity("s") * system.parameters["trolley_mass"] / 10

        return replace(CRANE, limits=(*CRANE.limits, sc.Limit("trolley power", "W", lower, "", power, upper=upper)))

    def test_from_above_and_from_below(self) -> None:
        t = np.linspace(0.0, 20.0, 20_001)
        exact = CRANE.exact(t)
        power = exact["F"] * scipy.interpolate.make_interp_spline(t, exact["s"], k=5).derivative()(t)
        for lower, upper in ((-100.0, 8.0), (-5.0, 100.0)):
            found = present(refusal(self.limited(lower, upper)))
            first = np.flatnonzero((power < lower) | (power > upper))[0]
            assert found["name"] == "trolley power"
            assert float(found["time"]) == pytest.approx(t[first], abs=2e-3)
        assert refusal(self.limited(1.001 * power.min(), 1.001 * power.max())) is None

    def test_multipliers_as_the_tension_that_they_make(self) -> None:
        def pull(system: sc.MechanicalSystem) -> ca.SX:
            return 2 * system.lam[3] * system.coordinates["l"]

        limits = (sc.Limit("pull", "N", 0.0, "the rope is overloaded", pull, upper=985.0),)
        by_name = present(refusal(CRANE.with_limits(tension=(0.0, 985.0))))
        with pytest.raises(
            sc.InvalidReference, match="the rope is overloaded: pull goes beyond its upper limit"
        ) as said:
            sc.solve(replace(CRANE, limits=limits))
        assert f"at t = {by_name['time']} s" in str(said.value)

    def test_symbols_of_another_model_are_refused(self) -> None:
        with pytest.raises(sc.ServocoreError, match="needs a function that returns an expression"):
            sc.Limit("x", "m", 0.0, "", "x")  # type: ignore[arg-type]  # wrong on purpose
        strange = sc.Limit("it", "1", 0.0, "", lambda _: ca.SX.sym("strange"), upper=1.0)
        with pytest.raises(sc.InvalidModel, match=r"a limit holds symbols that are none of this model: \['strange'\]"):
            sc.solve(replace(CRANE, limits=(strange,)))

    def test_bounds_the_wrong_way_round_are_refused(self) -> None:
        with pytest.raises(sc.InvalidSetting, match="must run from a lower to an upper bound, not from 2 to 1 N"):
            sc.Limit("F", "N", 2.0, "", lambda system: system.u[1], upper=1.0)


class TestRuns:
    """Where nothing is inverted at an instant, or a step errs, the run itself is judged."""

    @pytest.mark.parametrize(("name", "bound"), [("u", 3.0), ("x", 1.5), ("x.rate", 0.5), ("u.rate", 5.0)])
    def test_a_system_with_internal_dynamics_keeps_limits_at_the_instants_of_its_run(
        self, name: str, bound: float
    ) -> None:
        scene = sc.scenes.mass_on_car()
        run = sc.solve(scene)
        values = run[name.removesuffix(".rate")]
        if name.endswith(".rate"):
            values = np.gradient(values, run.t)
        first = run.t[(np.abs(values) > bound).argmax()]
        with pytest.raises(sc.InvalidReference) as refused:
            sc.solve(scene.with_limits(**{name: bound}))
        assert float(present(SAID.search(str(refused.value)))["time"]) == pytest.approx(first, abs=1.01 * run.t[1])
        kept = sc.solve(scene.with_limits(**{name: 1.01 * np.abs(values).max()}))
        assert kept.names == run.names
        np.testing.assert_allclose(kept.values, run.values, atol=1e-9)

    def test_a_crane_that_follows_its_branch_across_the_axis_keeps_limits_too(self) -> None:
        across = sc.scenes.rotary_crane(across_axis=True)
        across = across.with_reference(sc.rest_to_rest((5.0, 0.0, -5.0), (-5.0, 0.1, -5.0), 20.0))
        with pytest.raises(sc.InvalidReference, match=r"F goes beyond its lower limit of -5 N"):
            sc.solve(across.with_limits(F=5))

    def test_a_step_that_errs_beyond_a_limit_which_the_exact_motion_keeps_is_told_apart(self) -> None:
        peak = np.abs(sc.solve(CRANE)["M_b"]).max()
        limited = CRANE.with_limits(M_b=1.001 * peak)
        with pytest.raises(sc.InvalidReference, match=r"M_b goes beyond .*; the exact motion keeps that limit$"):
            sc.solve(limited, sc.Projected(), sc.BDF(2), step=0.5)
        sc.solve(limited)

    def test_without_checks_limits_are_left_out(self) -> None:
        assert np.abs(sc.solve(CRANE.with_limits(F=1), checks=False)["F"]).max() > 17.0


def hoist(pushes: bool | None, told: bool, duration: float) -> sc.Scene:
    """Return a mass on a rope from the ground's origin, lowered by 4 m: it falls freely where that takes 1 s."""
    p = sc.Parameters(sc.Parameter("m", 2.0, "kg"), sc.Parameter("g", 9.81, "m/s2"))
    parts = (PointMass("load", p["m"]), sc.Quantity("l", "m"))
    assembly = Assembly(parts=parts, parameters=p, gravity=(0, 0, -p["g"]))
    load, length = assembly.point("load"), assembly.augmented("l")
    constraints = {
        "x": load.position[0],
        "y": load.position[1],
        "cable": distance(GROUND.at(), load, length, pushes=pushes),
    }
    lam = assembly.multipliers(constraints)
    system = assembly.system(
        "hoist",
        constraints=constraints,
        multipliers=lam,
        inputs={sc.Quantity("F", "N"): length},
        outputs={sc.Quantity("z", "m"): load.position[2]},
        guess=lambda y: {"load": ca.vertcat(0, 0, y[0]), "l": -y[0]},
        home=(-2.0,),
        observables={sc.Quantity("pull", "N"): 2 * length * lam["cable"]} if told else None,
    )
    return sc.Scene("hoist", {"points": lambda: system}, sc.rest_to_rest((-1.0,), (-5.0,), duration))


class TestRopes:
    @pytest.mark.parametrize(("told", "name"), [(False, "cable.tension"), (True, "pull")])
    def test_a_rope_that_would_have_to_push_is_refused_by_the_name_of_its_tension(self, told: bool, name: str) -> None:
        slow, fast = hoist(None, told, 3.0), hoist(None, told, 1.0)
        found = sc.solve(slow)
        np.testing.assert_allclose(found[name], 2.0 * (9.81 + slow.reference.jet(found.t, 2)[:, 2, 0]), rtol=1e-12)
        slack = rf"slack at t = 0\.12\d+ s: {re.escape(name)} comes to 0 N, .* in more than 1\.95\d* s the same law"
        negative = rf"{re.escape(name)} is -\S+ N, it must stay positive: a rope cannot push$"
        runs: tuple[tuple[Callable[[sc.Scene], object], str], ...] = (
            (sc.solve, slack),
            (lambda scene: sc.solve(scene, sc.Projected(), sc.BackwardEuler()), slack),
            (lambda scene: sc.ExactInversion(scene)(np.linspace(0.0, 1.0, 50)), negative),
        )
        for run, said in runs:
            with pytest.raises(sc.IntegrationFailed, match=said):
                run(fast)

    def test_a_cylinder_may_push(self) -> None:
        assert sc.solve(hoist(True, True, 1.0))["pull"].min() < -10.0

    def test_a_rope_of_constant_length_is_one_and_a_link_is_none(self) -> None:
        assembly = Assembly(parts=(PointMass("load", 1.0),), parameters=sc.Parameters(), gravity=(0, 0, -9.81))
        load, q = assembly.point("load"), assembly.coordinates.q
        assert rope(GROUND.at(), load, 2.0).is_rope(q)
        assert not distance(GROUND.at(), load, 2.0).is_rope(q)

    def test_a_rope_that_pushes_between_two_instants_only_is_refused_too(self) -> None:
        """Twenty-one instants; g + z'' is below zero for 28 ms in the middle of one interval."""
        scene = hoist(None, False, 3.0)
        amplitude, speed = 0.3, np.sqrt(9.81 * 1.0002 / 0.3)
        period = 2 * np.pi / speed
        path = sc.periodic((-3.0,), [[0.0]], [[amplitude]], period=period)
        found = sc.certify(sc.solve(scene.with_reference(path), step=period / 22))
        assert [each.what for each in found.statements if each.verdict == "refuted"] == ["cable.tension positive"]


def two_ropes() -> sc.MechanicalSystem:
    """Return a load on two ropes from (-2, 0) and (2, 0), their lengths driven; on that line they are singular."""
    q = coordinates("x z l_1 l_2")
    x, z, *lengths = ca.vertsplit(q.q)
    lam, anchors = ca.SX.sym("lam", 2), (-2.0, 2.0)
    rows = [(x - at) ** 2 + z**2 - length**2 for at, length in zip(anchors, lengths, strict=True)]
    return lagrange(
        "two ropes",
        q,
        (100.0 * ca.sumsqr(q.v[:2]) + ca.sumsqr(q.v[2:])) / 2,
        {"x": x, "z": z},
        {"F_1": lengths[0], "F_2": lengths[1]},
        potential=981.0 * z,
        constraints=ca.vertcat(*rows),
        multipliers=lam,
        guess=lambda at: (at[0], at[1], *(ca.norm_2(ca.vertcat(at[0] - each, at[1])) for each in anchors)),
        home=(0.3, -1.0),
        observables={sc.Quantity(f"tension_{k + 1}", "N"): 2 * lam[k] * length for k, length in enumerate(lengths)},
    )


class TestPoles:
    SYSTEM = two_ropes()

    def lifted(self, gap: float) -> sc.Scene:
        """Return the load lifted to a gap below the line of its anchors, at t = 1 s, and lowered again."""
        path = sc.periodic((0.2, -1.0 - gap), [[0.0, 0.0]], [[0.0, 1.0]], period=4.0)
        return sc.Scene("two_ropes", {"points": lambda: self.SYSTEM}, path)

    @pytest.mark.parametrize("steps", thinned([50, 101, 206], lambda steps: steps == 101))
    def test_a_force_that_grows_to_1e9_between_two_instants_is_refuted_with_time_and_value(self, steps: int) -> None:
        found = sc.solve(self.lifted(7.3e-7), step=4.0 / steps)
        assert np.abs(found["tension_1"]).max() < 3e7
        refuted = next(each for each in sc.certify(found).statements if each.verdict == "refuted")
        assert refuted.what.startswith("F_1 between instants")
        assert refuted.time == pytest.approx(1.0, abs=1e-4)
        assert 0.8e9 < abs(float(refuted.sentence.split()[2])) < 1.3e9

    @pytest.mark.parametrize("steps", [50, 200, 201, 206])
    def test_a_tension_that_is_only_large_is_left_alone(self, steps: int) -> None:
        found = sc.solve(self.lifted(0.05), step=4.0 / steps)
        assert found["tension_1"].max() > 5e3

    @pytest.mark.parametrize("steps", [20, 21, 200, 201])
    def test_a_tension_that_changes_its_sign_through_a_pole_is_refused(self, steps: int) -> None:
        path = sc.rest_to_rest((0.0, -2.0), (0.5, 2.0), 4.0)
        with pytest.raises(sc.IntegrationFailed, match=r"t = (1\.8|1\.98|1\.99\d+|2) s"):
            sc.solve(sc.Scene("two_ropes", {"points": lambda: self.SYSTEM}, path), step=4.0 / steps)

    def test_a_limit_by_name_refuses_such_a_path_at_the_first_time(self) -> None:
        scene = self.lifted(1e-6).with_limits(tension_1=(0.0, 5000.0))
        t = np.linspace(0.0, 1.0, 200_001)
        z = np.sin(np.pi * t / 2) - 1.0 - 1e-6
        acceleration = 9.81 - (np.pi / 2) ** 2 * np.sin(np.pi * t / 2)
        # T_1 (2.2, z)/l_1 + T_2 (-1.8, z)/l_2 = 100 (0, -(g + z''))
        tension = 100.0 * acceleration * 1.8 / 4.0 * np.hypot(2.2, z) / -z
        found = present(refusal(scene))
        assert float(found["time"]) == pytest.approx(t[(tension > 5000.0).argmax()], abs=1e-5)
        assert float(found["worst"]) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.usefixtures("empty_folder")
class TestWhatIsLeft:
    """A solution tells how much its limits leave, and how long its law must take at least."""

    def test_margins_are_those_of_the_closed_form(self) -> None:
        scene = CRANE.with_limits(F=60, swing="5 deg", M_w=(-104, None), **{"s.rate": 1.2})
        solution = sc.solve(scene)
        exact = scene.exact(solution.t)
        left = solution.margins
        assert set(left) == {"F", "swing", "M_w", "s.rate"}
        assert left["F"].slack == pytest.approx(60.0 - np.abs(exact["F"]).max(), abs=1e-9)
        assert left["swing"].slack == pytest.approx(np.radians(5.0) - exact["swing"].max(), abs=1e-9)
        assert left["M_w"].slack == pytest.approx(exact["M_w"].min() + 104.0, abs=1e-9)
        k = int(np.abs(exact["F"]).argmax())
        assert (left["F"].time, left["F"].value) == pytest.approx((solution.t[k], exact["F"][k]))
        assert 0.0 < left["s.rate"].slack < 1.2

    def test_without_limits_there_are_no_margins(self) -> None:
        assert sc.solve(CRANE).margins == {}

    @pytest.mark.parametrize("text", ["F = true", "F = [1, 2, 3]", "s = 1979-05-27", "F ="])
    def test_a_file_of_limits_that_holds_something_else_is_refused(self, text: str) -> None:
        with pytest.raises(sc.InvalidModel, match=r"limits\.toml"):
            sc.read_limits(write("limits.toml", text))

    @pytest.mark.parametrize("text", ["s = 9\ns.rate = 1.2", "s.rate = 1.2\ns = 9"])
    def test_a_limit_beside_one_of_its_rate_is_told_how_to_be_written(self, text: str) -> None:
        with pytest.raises(sc.InvalidModel, match=r'then written "s.rate" = 1.2, in quotation marks'):
            sc.read_limits(write("limits.toml", text))
        assert sc.read_limits(write("limits.toml", text.replace("s.rate", '"s.rate"'))) == {"s": 9, "s.rate": 1.2}

    @pytest.mark.parametrize("name", ["swing", "M_b", "phi"])
    def test_what_rests_on_a_lower_bound_of_nought_keeps_it_until_it_goes_below(self, name: str) -> None:
        scene = CRANE.with_limits(**{name: (0, None)})
        if name != "M_b":
            assert sc.solve(scene).margins[name].slack == pytest.approx(0.0, abs=1e-12)
        else:
            said = present(refusal(scene))
            assert (said["side"], said["bound"]) == ("lower", "0")
            assert float(said["time"]) == pytest.approx(11.1865, abs=1e-4)
