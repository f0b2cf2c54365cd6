"""`effects`: which physical effects a scene may leave out, estimated first and simulated where that is weak.

The input deficit of a plant with an effect, driven by the inputs of a model without it, is to first order

    delta = u_L - u_S + K (y_L - y_S) + D (y_L' - y_S')

with the exact inputs u and positions y of the drives of both models along the same path. Under u_S - delta the *small*
model shows the error: the plant that follows the path under u_L does so for every strength of the effect, so that the
derivative of its motion under u_S is minus that of the small model by its inputs, times u_L.

The estimate is unreliable where the response of the plant to it differs from that of the small model: with a second
swing of a body below its hook, with a shorter rope, with drives that stick. Both follow for small changes about rest,
where the path starts and ends: where they differ by more than a tenth the plant is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from servocore.checks.before_run import require_feasible
from servocore.effects.closed_loop import COARSEST, linear_answers, run_loop
from servocore.effects.model_inversion import at_rest, inverted
from servocore.effects.position_loops import PositionLoops
from servocore.effects.report import REFUSED, SIMULATED, EffectRow, EffectsReport
from servocore.errors import (
    InvalidModel,
    InvalidReference,
    InvalidSetting,
    ServocoreError,
    described,
    require_kind,
    require_positive,
)
from servocore.model.scene import ModelFactory, Scene, require_scene
from servocore.model.system import MechanicalSystem
from servocore.problem import Problem
from servocore.references.base import Reference
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import RestToRest

_WEAK = 2.0  # an estimate within this factor of the tolerance is checked by simulation
_OTHERWISE = 0.1  # largest relative difference of the linear answers of plant and small model at which estimates hold
_LARGE = 0.15  # relative change of an input from which on open loop estimates fail
_TAIL = 6.0  # s after the end of a path in which the residual swing is looked for: two swings of some two metres
_NOT_FLAT = "simulated because it has internal dynamics, or no inversion at all, so that there is nothing to compare"
_ANSWERS = "simulated because its estimate is unreliable: the plant's dynamics differ"
_FEWEST = 500  # instants of a path, however short


def effects(
    scene: Scene,
    *,
    loops: PositionLoops | None = PositionLoops(),  # noqa: B008 - a frozen value
    tolerance: float = 0.005,
    plant: Mapping[str, ModelFactory] | None = None,
    measured: tuple[str, ...] = (),
    parameters: Mapping[str, float] | None = None,
    simulate: bool = False,
) -> EffectsReport:
    """Determine the effects that a scene needs for a tolerance, and the error without each of them.

    Parameters
    ----------
    scene : Scene
        With its path and parameters.
    loops : PositionLoops or None
        Position loops of the plant, which get their references from the model without the effect; None: its inputs
        alone drive the plant.
    tolerance : float
        How far the load may be off its path, in the unit of the path.
    plant : mapping of str to callable, optional
        Effects of one's own: factories of models of the plant by name. Such a model has the scene's inputs and outputs.
    measured : tuple of str, optional
        Quantities that the drives measure, one name an input, in a scene that declares no effects.
    parameters : mapping of str to float, optional
        Values of parameters of the effects, or of plants of one's own.
    simulate : bool
        Whether every plant is simulated.

    Returns
    -------
    EffectsReport
        One row an effect, largest error first.

    Raises
    ------
    InvalidModel
        If a scene declares no effects and none are given, or a parameter is unknown.
    InvalidSetting
        If the tolerance or the position loops are invalid.
    InvalidReference
        If the path breaks a limit of the scene.
    """
    require_scene(scene, "effects")
    if loops is not None:
        require_kind(loops, PositionLoops, "loops", "PositionLoops(...) or None", InvalidSetting)
    require_positive(tolerance, "the tolerance", "a length")
    study = _Study(scene, loops, float(tolerance), dict(parameters or {}), measured or scene.effects.measured, simulate)
    study.require_parameters(plant or {})
    require_feasible(Problem.of(scene))
    judged, total = list[EffectRow](), 0.0
    for row in sorted((study.row(*case) for case in study.cases(plant or {})), key=lambda row: row.error):
        refused = row.how == REFUSED
        total += 0.0 if refused else row.error
        judged.insert(0, replace(row, needed=total > tolerance and not refused))
    of_plant = "With the inputs alone"
    if loops is not None:
        of_plant = f"With drives of {loops.bandwidth:g} rad/s and damping {loops.damping:g}"
    return EffectsReport(scene, tuple(judged), float(tolerance), of_plant)


@dataclass(frozen=True, eq=False)
class _Study:
    """The settings that all rows of a report share."""

    scene: Scene
    loops: PositionLoops | None
    tolerance: float
    parameters: dict[str, float]
    measured: tuple[str, ...]
    simulate: bool

    def require_parameters(self, plant: Mapping[str, ModelFactory]) -> None:
        """Raise `InvalidModel` if a parameter belongs to no effect, or leaves its bounds; or if there is no effect."""
        declared = self.scene.effects
        if not (declared.declared or plant):
            raise InvalidModel(
                f"{self.scene.name} declares no effects; give plants of your own: plant=dict(name=factory)"
            )
        if not self.measured:
            raise InvalidSetting(
                f"{self.scene.name} declares no quantities that its drives measure: give measured=('s', 'l')"
            )
        known = dict(declared.parameters)
        for name, factory in plant.items():
            known |= {parameter.name: parameter for parameter in self._plant(name, factory).parameters.declared}
        for name, value in self.parameters.items():
            if name not in known:
                raise InvalidModel(f"no parameter of an effect is called {name}; there are {', '.join(known)}")
            known[name].check(value)

    def _plant(self, name: str, factory: ModelFactory) -> MechanicalSystem:
        """Return a model of one's own; raise `InvalidModel` if it is none, or not one of this scene."""
        if not callable(factory):
            raise InvalidModel(f"the plant {name} must be a function that returns a model, not {described(factory)}")
        if name in {effect.name for effect in self.scene.effects.declared}:
            raise InvalidModel(f"{name} is an effect of {self.scene.name}; the plant needs another name")
        system, model = factory(), self.scene.model()
        require_kind(system, MechanicalSystem, f"the result of the plant {name}", "a MechanicalSystem", InvalidModel)
        for what in ("inputs", "outputs"):
            names, known = (", ".join(each.name for each in getattr(of, what)) for of in (system, model))
            if len(getattr(system, what)) != len(getattr(model, what)):
                raise InvalidModel(f"the plant {name} has the {what} {names}, {self.scene.name} has {known}")
        return system

    def cases(self, plant: Mapping[str, ModelFactory]) -> Iterator[tuple[str, Scene, Scene, bool]]:
        """Yield name, model with it, model without it, and whether it is left out, of every effect."""
        scene, declared = self.scene, self.scene.effects
        base = self._set(scene.with_effects()) if declared.declared else scene
        for effect in declared.declared:
            if not effect.listed or effect.name in declared.added | declared.left_out:
                continue
            if effect.left_out:
                yield effect.name, base, self._set(scene.with_effects(without=[effect.name])), True
            else:
                yield effect.name, self._set(scene.with_effects(effect.name)), base, False
        for name, factory in plant.items():
            yield name, self._set(replace(scene, models={"plant": factory}, drives={})), base, False

    def _set(self, scene: Scene) -> Scene:
        known, values = scene.model().parameters.names, {**self.scene.parameters, **self.parameters}
        return replace(scene, parameters={name: value for name, value in values.items() if name in known})

    def row(self, name: str, large: Scene, small: Scene, left_out: bool) -> EffectRow:
        """Return the row of an effect; of one that cannot be judged with the reason."""
        row = EffectRow(name, left_out=left_out)
        try:
            array = Problem.of(large).resolved.outcome
            if not isinstance(array, InvalidModel):
                row = replace(
                    row,
                    index=array.signature.index,
                    internal_states=array.signature.degrees_of_freedom,
                    derivatives=array.reference_order,
                    unknowns=len(array.unknowns),
                )
            order = max(row.derivatives or 0, Problem.of(small).array.reference_order)
            reference = smooth_enough(large.reference, order)
            moved = (scene.with_reference(reference) for scene in (large, small))
            law = f"law {reference.profile.name}" if isinstance(reference, RestToRest) else "the scene's own law"
            return self._compared(replace(row, law=law), *moved)
        except ServocoreError as error:
            return EffectRow(name, left_out=left_out, how=REFUSED, reason=str(error))

    def _compared(self, row: EffectRow, large: Scene, small: Scene) -> EffectRow:
        """Return a row with its error: estimated, and simulated where an estimate is weak or impossible."""
        instants = max(math.ceil(large.reference.duration / COARSEST), _FEWEST) + 1
        plant, model = Problem.of(large), Problem.of(small)
        measured, hanging = large.effects.measured or self.measured, self.scene.effects.hanging
        without = inverted(model, self.measured, instants)
        with_effect = inverted(plant, measured, instants) if row.internal_states == 0 else at_rest(plant, measured)
        gains = (with_effect if row.left_out else without).gains(self.loops)
        end = large.reference.end_time
        tail = 0.0 if large.reference.jet([end, end + 1.0], 2)[:, 1:].any() else _TAIL  # where the path stays
        reason = _NOT_FLAT
        if row.internal_states == 0:
            # delta of the head of this file.
            inputs, positions, rates = np.split(with_effect.signals - without.signals, 3, axis=1)
            lacking = inputs + gains[0] * positions + gains[1] * rates
            estimate = run_loop(without, without, gains, -lacking, hanging, tail=tail)
            peaks = np.abs(without.inputs).max(axis=0)
            row = replace(
                row,
                microseconds=with_effect.microseconds,
                input_change=float((np.abs(inputs).max(axis=0) / np.where(peaks > 0.0, peaks, 1.0)).max()),
                error=estimate.error,
                swing=estimate.swing,
                estimate=estimate.error,
            )
            reason = self._weak(row)
            if not reason:
                of_model, of_plant = (linear_answers(e, gains, lacking, hanging) for e in (without, with_effect))
                reason = "" if (np.abs(of_plant - of_model) <= _OTHERWISE * of_model).all() else _ANSWERS
        if not reason:
            return row
        run = run_loop(with_effect, without, gains, 0.0, hanging, tail=tail)
        return replace(row, error=run.error, swing=run.swing, how=SIMULATED, reason="" if self.simulate else reason)

    def _weak(self, row: EffectRow) -> str:
        """Return why a row is to be simulated; empty where its estimate is good enough."""
        if self.simulate:
            return "requested"
        if self.tolerance / _WEAK < row.error < self.tolerance * _WEAK:
            return "simulated because its estimate is near the tolerance"
        if self.loops is None and (row.input_change or 0.0) > _LARGE:
            return "simulated because its inputs change much and no loop holds the drives"
        return "" if math.isfinite(row.error) else "simulated because the estimate was not survived"


def smooth_enough(reference: Reference, order: int) -> Reference:
    """Return a path with as many continuous derivatives; on the same way in the same time.

    Raises
    ------
    InvalidReference
        If a path that is too rough is no straight line from rest to rest.
    """
    if reference.smoothness >= order:
        return reference
    if not isinstance(reference, RestToRest):
        raise InvalidReference(
            f"the path is continuous up to its derivative of order {reference.smoothness}, this effect needs order"
            f" {order}: the law is changed automatically for a straight line from rest to rest only; points take"
            " a higher rest_order"
        )
    return replace(reference, profile=polynomial(2 * order + 1), smoothness=order)
