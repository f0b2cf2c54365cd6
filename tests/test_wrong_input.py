"""Input that is wrong ends in one sentence that names the culprit: models, scenes, settings and paths.

What is wrong is drawn at random where its kind leaves a choice: which entry, NaN or infinite, how large.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DataObject
from problems import actuated_chain, car_chain, changed, driven_pendulum, redundant_pendulum, scene

import servocore as sc
from servocore import rotationless as rl
from servocore.analysis import StructureReport
from servocore.model.system import DERIVED
from servocore.references.rest_to_rest import RestToRest

CRANE = scene("rotary_crane")
PATH = sc.rest_to_rest((0.4,), (0.6,), 2.0)
NOT_FINITE = (float("nan"), float("inf"), -float("inf"))
FIELDS = ("mass", "output", "input_matrix", "potential", "force", "constraints", "gyroscopic", "guess")


def refused(
    error: type[sc.InvalidModel] | type[sc.InvalidReference] | type[sc.InvalidSetting],
    said: str,
    make: Callable[[], object],
) -> None:
    """Check that `make` raises `error` with exactly this sentence, but for what follows ``...``."""
    with pytest.raises(sc.ServocoreError) as caught:
        make()
    assert type(caught.value) is error
    text = str(caught.value)
    assert text.startswith(said.removesuffix("...")) if said.endswith("...") else text == said


def chain_refused(said: str, **fields: Any) -> None:
    """Check that the chain does not exist with these fields, and what is said of it."""
    refused(sc.InvalidModel, f"actuated chain: {said}", lambda: changed(actuated_chain(), **fields))


def factory_of(system: sc.MechanicalSystem) -> Callable[[], sc.MechanicalSystem]:
    return lambda: system


def a_scene(
    system: Callable[[], sc.MechanicalSystem] = driven_pendulum,
    reference: RestToRest = PATH,
    **more: Any,
) -> sc.Scene:
    return sc.Scene("mine", {"only": system}, reference, **more)


# Numbers that are none ------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(FIELDS), st.sampled_from(NOT_FINITE), st.booleans(), st.data())
def test_an_entry_that_is_no_finite_number_is_refused_by_name(
    field: str, value: Any, hidden: bool, data: DataObject
) -> None:
    """Wherever it stands, plainly or within an expression."""
    system = redundant_pendulum()
    wrong = ca.densify(getattr(system, field)) + 0
    row, column = (data.draw(st.integers(0, size - 1)) for size in wrong.shape)
    wrong[row, column] = wrong[row, column] + value * system.p[0] if hidden else value
    if field == "mass":
        wrong[column, row] = wrong[row, column]
    coordinates = ("x", "z", "theta")
    rows = {"output": ("y",), "input_matrix": ("torque",), "constraints": ("1", "2"), "potential": ("",)}
    name = rows.get(field, coordinates)[row]
    if field in ("mass", "input_matrix"):
        first = (min(row, column), max(row, column)) if field == "mass" else (row, column)
        name = f"{coordinates[first[0]] if field == 'mass' else name}, {coordinates[first[1]]}"
    said = f"redundant pendulum: {field}{f'[{name}]' if name else ''} holds {value}, which is no finite number"
    refused(sc.InvalidModel, said, lambda: changed(system, **{field: wrong}))


@pytest.mark.parametrize("value", ["80", True, np.True_, None, 1j, [1.0, 2.0]])
def test_a_parameter_is_a_number_and_no_text_of_one(value: Any) -> None:
    crane = sc.scenes.rotary_crane()
    said = f"parameter load_mass must be a number, not {value!r}"
    refused(sc.InvalidModel, said, lambda: sc.solve(crane.with_parameters(load_mass=value)))


@pytest.mark.parametrize("value", NOT_FINITE)
def test_numbers_of_a_model_are_finite(value: float) -> None:
    chain_refused(f"home must hold a finite number for y2, not {value}", home=(1.0, value))
    chain_refused(f"home_parameters must hold a finite number for k, not {value}", home_parameters=(value, 1.0))
    power = {sc.Quantity("power"): value}
    chain_refused(f"observable power holds {value}, which is no finite number", observables=power)
    said, one = f"parameter m must be a finite number, not {value:g} kg", sc.Parameters(sc.Parameter("m", value, "kg"))
    refused(sc.InvalidModel, said, one.values)
    nominal = (
        "Coordinates(...): a quantity needs a name and a nominal magnitude that is positive and finite, not 'x' and "
    )
    refused(sc.InvalidModel, f"{nominal}{value}", lambda: sc.Coordinates(sc.Quantity("x", nominal=value)))


def test_a_value_that_is_missing_in_a_branch_not_taken_is_none_of_our_business() -> None:
    system = driven_pendulum()
    observable = ca.if_else(system.q[0] < 100.0, system.q[0], np.nan)
    assert changed(system, observables={sc.Quantity("angle in range", "rad"): observable})


def test_a_guess_without_a_value_at_home_asks_for_another_home() -> None:
    system = redundant_pendulum()
    said = (
        "redundant pendulum: the guess at home = (2.0,) has no value for x; home must be a value of y that the system"
        " can take"
    )
    guess = ca.vertcat(ca.sqrt(1 - system.gamma[0, 0]), 0, 0)
    refused(sc.InvalidModel, said, lambda: changed(system, guess=guess, home=(2.0,)))


# Masses ---------------------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.floats(-1e6, -1e-6))
def test_a_negative_mass_is_refused(value: float) -> None:
    said = f"the mass matrix is not positive semidefinite at home: that of x2 is {value:g}"
    chain_refused(said, mass=np.diag([3.0, value]))


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(1.01, 10.0))
def test_a_coupling_larger_than_the_masses_is_refused(first: float, second: float, factor: float) -> None:
    coupling = factor * np.sqrt(first * second)
    mass = np.array([[first, coupling], [coupling, second]])
    said = (
        "the mass matrix is not positive semidefinite at home: a motion of x1, x2 has negative kinetic"
        f" energy (eigenvalue {np.linalg.eigvalsh(mass)[0]:.3g})"
    )
    parts = np.abs(np.linalg.eigh([[1.0, factor], [factor, 1.0]])[1][:, 0])
    assert parts == pytest.approx(np.sqrt(0.5))
    chain_refused(said, mass=mass)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_every_mass_matrix_that_is_one_is_taken_however_singular(seed: int) -> None:
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((2, 1)) * 10.0 ** generator.uniform(-5, 5, (2, 1))
    assert changed(actuated_chain(), mass=root @ root.T)


def test_a_mass_that_grows_with_a_coordinate_may_vanish_at_home() -> None:
    system = driven_pendulum()
    assert changed(system, mass=2.0 * system.q[0])


def test_parameter_values_that_make_a_mass_negative_are_refused() -> None:
    def rod() -> sc.MechanicalSystem:
        theta, m = sc.Coordinates(sc.Quantity("theta", "rad")), sc.Parameters(sc.Parameter("m", 2.0, "kg"))
        fields = {"mass": m["m"], "output": theta.q, "potential": 0, "home_parameters": ()}
        return changed(driven_pendulum(), coordinates=theta, parameters=m, **fields)

    rods = sc.Scene("rods", {"rod": rod}, PATH).with_parameters(m=-3.0)
    said = "pendulum: the mass matrix is not positive semidefinite with m = -3: that of theta is -3"
    for look in (sc.solve, sc.analyse, sc.ExactInversion):
        refused(sc.InvalidModel, said, partial(look, rods))


# Names ----------------------------------------------------------------------------------------------------------------


TWINS = (sc.Quantity("twin"),) * 2


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"inputs": TWINS}, "two of the inputs are called twin, one of them needs another name"),
        ({"outputs": TWINS}, "two of the outputs are called twin, one of them needs another name"),
        (
            {"observables": {sc.Quantity("power", "W"): 1.0, sc.Quantity("power", "kW"): 2.0}},
            "two of the observables are called power, one of them needs another name",
        ),
        ({"inputs": (sc.Quantity("x1"), sc.Quantity("F"))}, "x1 is the name of two quantities, one of the inputs"),
        ({"outputs": (sc.Quantity("x2"), sc.Quantity("y"))}, "x2 is the name of two quantities, one of the outputs"),
        ({"observables": {sc.Quantity("F1"): 3.0}}, "F1 is the name of two quantities, one of the inputs"),
        ({"inputs": (sc.Quantity("k"), sc.Quantity("F"))}, "k is the name of two quantities, one of the inputs"),
        ({"inputs": (sc.Quantity("time"), sc.Quantity("F"))}, "one of the inputs is called time, which is the column"),
        (
            {"outputs": (sc.Quantity("x.rate"), sc.Quantity("y"))},
            "one of the outputs is called x.rate, which is the limit of a rate",
        ),
    ],
)
def test_one_name_for_two_quantities_is_refused(fields: dict[str, Any], said: str) -> None:
    chain_refused(f"{said}...", **fields)


def test_an_output_may_have_the_name_of_the_coordinate_that_it_is() -> None:
    assert changed(actuated_chain(), outputs=(sc.Quantity("x1"), sc.Quantity("x2")))


def test_symbols_of_one_group_are_no_symbols_of_another() -> None:
    said = "actuated chain: a symbol stands for two among coordinates, parameters, multipliers, inputs and reference"
    system = actuated_chain()
    refused(sc.InvalidModel, said, lambda: changed(system, u=system.q))


# Kinds ----------------------------------------------------------------------------------------------------------------


def test_arrays_and_lists_are_taken_for_expressions() -> None:
    system = actuated_chain()
    k = system.p[0]
    same = changed(
        system,
        mass=np.array([[3.0, 0.5], [0.5, 2.0]]),
        input_matrix=[[-1.0, 0], [0, -1]],
        output=[system.q[0], system.q[1]],
        force=[-system.p[1] * each for each in ca.vertsplit(system.v)],
        potential=k / 2 * (system.q[0] ** 2 + (system.q[1] - system.q[0]) ** 2),
        guess=(0.0, 0.0),
        constraints=[],
        home=np.array([1.0, 1.0]),
        multipliers=DERIVED,
    )
    path = sc.rest_to_rest((0.0, 0.0), (1.0, 0.5), 1.0)
    found, expected = (sc.solve(sc.Scene("s", {"m": factory_of(one)}, path), step=0.1) for one in (same, system))
    np.testing.assert_array_equal(found.values, expected.values)


def test_one_input_takes_a_row_as_a_list() -> None:
    system = redundant_pendulum()
    row = changed(system, input_matrix=[0.0, 0.0, -1.0]).input_matrix
    assert row.shape == (1, 3)
    assert row.nnz() == 1, "zeros of a list are no entries"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"mass": ca.MX.eye(2)}, "mass is a casadi.MX; models are written with the symbols of casadi.SX"),
        ({"mass": "2"}, "mass must be a casadi.SX, an array or a real number, not the text '2'"),
        ({"force": None}, "force must be a casadi.SX, an array or a real number, not None"),
        ({"output": len}, "output must be a casadi.SX, an array or a real number, not a..."),
        ({"u": ca.SX.zeros(2)}, "u must be symbols of casadi.SX.sym, not expressions"),
        ({"inputs": "F"}, "inputs must be a sequence of Quantity, not the text 'F'"),
        ({"inputs": ("F", "G")}, "inputs must be made of Quantity, such as Quantity('x', 'm'), not the..."),
        ({"coordinates": ("x", "y")}, "coordinates must be a Coordinates, not a tuple"),
        ({"parameters": {"k": 1.0}}, "parameters must be a Parameters, not a dict"),
        ({"observables": [1]}, "observables must be a Mapping, not a list"),
        ({"home": (1.0,)}, "home has length 1, one number is needed for each of y1, y2"),
        ({"home": "ab"}, "home must be a tuple of numbers, not the text 'ab'"),
        ({"home": 1.0}, "home must be a tuple of numbers, not 1.0"),
        ({"home": (1.0, "2")}, "home must hold a finite number for y2, not the text '2'"),
        ({"home_parameters": (1.0,)}, "home_parameters has length 1, one number is needed for each of..."),
    ],
)
def test_a_field_of_the_wrong_kind_or_size_is_refused(fields: dict[str, Any], said: str) -> None:
    chain_refused(said, **fields)


def test_a_name_that_is_no_text_and_rows_of_different_lengths_are_refused() -> None:
    rows = [[1.0, 2.0], [3.0]]
    refused(sc.InvalidModel, "the name of a system must be a text, not 3", lambda: changed(actuated_chain(), name=3))
    said = "the rows of actuated chain: mass have different lengths: 2, 1"
    refused(sc.InvalidModel, said, lambda: changed(actuated_chain(), mass=rows))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: sc.Coordinates("x"),  # type: ignore[arg-type]  # wrong on purpose
            "Coordinates(...) must be made of Quantity, such as Quantity('x', 'm'), not the...",
        ),
        (
            lambda: sc.Parameters(sc.Quantity("m")),  # type: ignore[arg-type]  # wrong on purpose
            "Parameters(...) must be made of Parameter, one by one, not a Quantity",
        ),
        (lambda: sc.Parameter("m", 1.0, "kg", 5.0, 2.0), "parameter m has no value between 5.0 and 2.0 kg"),
        (lambda: sc.Parameter("m", "3", "kg"), "the default of parameter m must be a number..."),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: a_scene(lambda: None).model(), "mine: the factory of only returned None, not a MechanicalSystem"),  # type: ignore[arg-type, return-value]  # wrong on purpose
        (lambda: a_scene(lambda _: None).model(), "mine: the factory of only is called without arguments: ..."),  # type: ignore[arg-type, misc]  # wrong on purpose
        (lambda: sc.Scene("s", {}, PATH), "s: a scene needs a model"),
        (
            lambda: sc.Scene("s", driven_pendulum, PATH),  # type: ignore[arg-type]  # wrong on purpose
            "s: models must be factories by name, such as {'only': make}, not...",
        ),
        (lambda: a_scene(limits="none"), "mine: limits must be a tuple of Limit, not the text 'none'"),
        (lambda: a_scene(closed_form=3), "mine: closed_form must be a function, not 3"),
        (lambda: sc.analyse("crane"), "the problem must be a Scene, not the text 'crane'"),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.compile_plant(CRANE), "the system to be compiled must be a MechanicalSystem, not a Scene"),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: rl.revolute(rl.GROUND, rl.GROUND), "a joint is between two places, not a Frame; frame.at(...) is one"),  # type: ignore[arg-type]  # wrong on purpose
        (
            lambda: rl.Assembly((), sc.Parameters(), (0.0, -9.81)),
            "gravity must be three finite numbers, not (0.0, -9.81)",
        ),
    ],
)
def test_parts_of_a_model_of_the_wrong_kind_are_refused(make: Callable[[], object], said: str) -> None:
    refused(sc.InvalidModel, said, make)


def test_a_system_where_a_factory_belongs_is_refused_with_what_to_write() -> None:
    said = (
        "mine: the model only is a MechanicalSystem; models are functions that make a system: models={'only': lambda:"
        " system}"
    )
    refused(sc.InvalidModel, said, lambda: a_scene(driven_pendulum()))  # type: ignore[arg-type]  # wrong on purpose


@pytest.mark.parametrize(
    "call",
    [sc.solve, lambda s: sc.simulate(s, None), sc.ExactInversion, lambda s: sc.export_fmu(s, "x.fmu")],  # type: ignore[arg-type]  # wrong on purpose
)
def test_a_system_where_a_scene_belongs_is_refused_with_what_to_write(call: Callable[[sc.Scene], object]) -> None:
    with pytest.raises(sc.InvalidModel, match=r"takes a Scene, not the system pendulum: Scene\(name, models=.*lambda"):
        call(driven_pendulum())  # type: ignore[arg-type]  # wrong on purpose


@pytest.mark.parametrize("reference", ["line", sc.Reference, sc.rest_to_rest, None])
def test_a_reference_that_is_none_is_refused(
    reference: str | type[sc.Reference] | Callable[..., RestToRest] | None,
) -> None:
    with pytest.raises(sc.InvalidReference, match=r"^mine: the reference must be a Reference, not "):
        a_scene(reference=reference)  # type: ignore[arg-type]  # wrong on purpose


@pytest.mark.parametrize("look", [sc.solve, sc.analyse, sc.ExactInversion])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_reference_of_another_dimension_is_refused_with_both_and_the_outputs(
    look: Callable[..., sc.Solution] | Callable[..., StructureReport] | type[sc.ExactInversion], dimension: int
) -> None:
    wrong = a_scene(reference=sc.rest_to_rest((0.0,) * dimension, (1.0,) * dimension, 1.0))
    said = f"mine needs a path with 1 components, this one has {dimension}; the outputs are angle"
    refused(sc.InvalidReference, said, lambda: look(wrong))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"formulation": "Reduced"}, "the formulation must be one such as Reduced(), not the text 'Reduced'"),
        (
            {"formulation": sc.Reduced},
            "the formulation must be one such as Reduced(), not the class Reduced; an instance...",
        ),
        (
            {"formulation": sc.BDF(2)},
            "the formulation must be one such as Reduced(), not a BDF; it is a method: write...",
        ),
        ({"method": "BDF"}, "the method must be one such as RadauIIA(3), not the text 'BDF'"),
        (
            {"method": sc.Projected()},
            "the method must be one such as RadauIIA(3), not a Projected; it is a formulation:...",
        ),
        ({"step": "0.1"}, "the step must be a time in s or Adaptive(...), not the text '0.1'"),
        ({"step": sc.Adaptive}, "the step must be a time in s or Adaptive(...), not the class Adaptive"),
        ({"step": True}, "the step must be a time in s or Adaptive(...), not True"),
        ({"step": np.array([0.1])}, "the step must be a time in s or Adaptive(...), not..."),
        ({"start": [0.1]}, "rotary crane, points: a start must be values by name, such as {'theta': 0.1}, not..."),
        ({"step": 1e-12}, "the step of 1e-12 s divides the duration of 20 s into 2e+13 steps, more than 1e+08"),
        ({"progress": 3}, "progress must be a function of (steps done, steps in all), not 3"),
        (
            {"formulation": sc.Reduced(states=(("q.none", 0),))},
            "rotary crane, points: a state is a variable and the order...",
        ),
    ],
)
def test_a_setting_of_the_wrong_kind_is_refused_with_what_to_write(arguments: Any, said: str) -> None:
    refused(sc.InvalidSetting, said, lambda: sc.solve(CRANE, **arguments))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: sc.BDF("3"), "the order of BDF must be a whole number, not the text '3'"),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.RadauIIA("3"), "the number of stages must be a whole number, not the text '3'"),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.fastest(CRANE, PATH, limits="F=3"), "limits must be bounds by name, as {'F': 60}, not the text..."),  # type: ignore[arg-type]  # wrong on purpose
    ],
)
def test_settings_of_methods_and_studies_of_the_wrong_kind_are_refused(make: Callable[[], object], said: str) -> None:
    refused(sc.InvalidSetting, said, make)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: sc.rest_to_rest(0.0, 1.0, 1.0),  # type: ignore[arg-type]  # wrong on purpose
            "a table with one start point a row is needed, not an array of shape (1,)",
        ),
        (lambda: sc.rest_to_rest((0.0,), (1.0,), "1"), "the duration of a path must be a time in s, not the text '1'"),  # type: ignore[arg-type]  # wrong on purpose
        (
            lambda: sc.rest_to_rest((0.0,), (1.0,), 1.0, "9"),  # type: ignore[arg-type]  # wrong on purpose
            "the profile of a path must be one such as DEGREE9, not the...",
        ),
        (lambda: sc.through([(0.0,), (1.0,)], ["a", "b"]), "the times of waypoints must be numbers in s, not a list"),
        (lambda: sc.sampled([0, 1], [[0], [1]], tolerance="x"), "2 samples are too few..."),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.figure_of_eight(0.0, 1.0, 2.0, 1.0), "a table with one centre a row is needed, not an array of..."),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.three_phase("x"), "the ramp of a three-phase profile must be a time in s, not the text 'x'"),  # type: ignore[arg-type]  # wrong on purpose
        (lambda: sc.from_csv(3), "the file of a path must be its name, not 3"),  # type: ignore[arg-type]  # wrong on purpose
        (
            lambda: sc.path_to_csv("path.csv"),  # type: ignore[arg-type]  # wrong on purpose
            "the argument of path_to_csv must be a Reference, not the text 'path.csv'",
        ),
        (lambda: PATH.jet("now", 0), "the times of a path must be numbers in s, not the text 'now'"),
        (lambda: PATH.jet(0.0, 2.5), "the order of a derivative must be a whole number, not 2.5"),  # type: ignore[arg-type]  # wrong on purpose
    ],
)
def test_paths_from_what_is_no_number_are_refused(make: Callable[[], object], said: str) -> None:
    refused(sc.InvalidReference, said, make)


# Dead and doubled -----------------------------------------------------------------------------------------------------


CHAIN = actuated_chain()


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (changed(CHAIN, input_matrix=np.diag([-1.0, 0.0])), ", the input F2 drives no coordinate"),
        (
            changed(CHAIN, input_matrix=[[-1.0, 2.0], [2.0, -4.0]]),
            ", the inputs F1, F2 drive the same: each is implied by the others",
        ),
        (changed(CHAIN, output=[CHAIN.q[0], 3.0]), ", the output y2 depends on no coordinate"),
        (
            changed(CHAIN, output=[CHAIN.q[0], ca.sin(CHAIN.q[0])]),
            ", the outputs y1, y2 follow the same coordinates: each is implied by the others",
        ),
        (
            changed(car_chain(), potential=0),  # nothing connects the car that is pushed to the one that is tracked
            ": no equation determines u.F, and servo constraint on y determines no variable; check for inputs that move"
            " nothing, and for outputs that no input moves or that follow from others",
        ),
    ],
)
def test_dead_doubled_and_loose_inputs_and_outputs_are_named(system: sc.MechanicalSystem, said: str) -> None:
    said, report = f"{system.name}: structurally singular{said}", sc.analyse(system)
    assert report.reason == said
    assert (report.classification, report.index) == ("singular here", None)
    assert "internal dynamics   unknown" in str(report)
    start, end = ((place,) * len(system.outputs) for place in (0.0, 1.0))
    mine = sc.Scene("mine", {"only": lambda: system}, sc.rest_to_rest(start, end, 1.0))
    for form in (None, sc.Projected(), sc.Original()):
        refused(sc.InvalidModel, said, partial(sc.solve, mine, form))
