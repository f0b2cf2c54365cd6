"""`Effect` and `Effects`: physical effects that a scene neglects, or may neglect, as data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

from servocore.errors import InvalidModel, described
from servocore.model.symbols import Parameter, Parameters
from servocore.model.system import MechanicalSystem

Assemble = Callable[[frozenset[str], frozenset[str]], MechanicalSystem]
"""(names of added effects, names of effects left out) -> the model."""


@dataclass(frozen=True)
class Effect:
    """A physical effect that a model includes or neglects.

    Parameters
    ----------
    name : str
        Such as ``friction``.
    assumption : str
        One sentence: its model, and the source.
    parameters : tuple of Parameter
        Parameters of the model with it beside those of the scene.
    left_out : bool
        False if the effect is added to the scene, True if the scene has it and it is left out.
    drives : mapping of str to str
        Positions that the drives measure, where they differ from those without it: ``{"phi": "phi_motor"}``.
    includes : tuple of str
        Names of effects that the model with this one contains too.
    listed : bool
        Whether tables have a row for it by default.
    """

    name: str
    assumption: str
    parameters: tuple[Parameter, ...] = ()
    left_out: bool = False
    drives: Mapping[str, str] = field(default_factory=dict, hash=False)
    includes: tuple[str, ...] = ()
    listed: bool = True


def _no_assembly(added: frozenset[str], left_out: frozenset[str]) -> MechanicalSystem:
    raise InvalidModel(f"there is no function that assembles a model with {', '.join(sorted(added | left_out))}")


@dataclass(frozen=True)
class Effects:
    """The effects that a scene declares, and a factory of the model with those that are added; equal ones share it.

    Parameters
    ----------
    declared : tuple of Effect
        With different names.
    drives : tuple of str
        Quantity that the drive of each input measures, by its name in the model.
    hanging : tuple of str
        Observables that together are the horizontal offset of the load from its suspension: its residual swing.
    assemble : callable
        A function of a module, so that models are shared.
    added, left_out : frozenset of str
        Names of the effects in which the scene differs from the one that declares them.
    """

    declared: tuple[Effect, ...] = ()
    drives: tuple[str, ...] = ()
    hanging: tuple[str, ...] = ()
    assemble: Assemble = _no_assembly
    added: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()

    def __getitem__(self, name: str) -> Effect:
        for effect in self.declared:
            if effect.name == name:
                return effect
        known = ", ".join(effect.name for effect in self.declared) or "none"
        raise InvalidModel(f"no effect is called {described(name) if not isinstance(name, str) else name}; there are"
                           f" {known}")  # fmt: skip

    def with_(self, names: Iterable[str], without: Iterable[str] = ()) -> Effects:
        """Return the effects of a scene with some added and others left out.

        Parameters
        ----------
        names : iterable of str
            Effects to add.
        without : iterable of str
            Effects to leave out.

        Returns
        -------
        Effects
            New effects; these are unchanged.

        Raises
        ------
        InvalidModel
            If there is no such effect.
        """
        wanted, unwanted = {self[name] for name in names}, {self[name] for name in without}
        both = sorted(effect.name for effect in wanted & unwanted)
        if both:
            raise InvalidModel(f"a model cannot be both with and without {', '.join(both)}")
        lacking = self.left_out - {effect.name for effect in wanted}
        having = self.added - {name.name for name in unwanted}
        return replace(
            self,
            added=having | {effect.name for effect in wanted if not effect.left_out},
            left_out=lacking | {name.name for name in unwanted if name.left_out},
        )

    def __call__(self) -> MechanicalSystem:
        """Assemble the model."""
        return self.assemble(self.added, self.left_out)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the quantities that the drives measure in the model."""
        names = list(self.drives)
        for name in self.added:
            names = [self[name].drives.get(each, each) for each in names]
        return tuple(names)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters of all declared effects by name."""
        return {parameter.name: parameter for effect in self.declared for parameter in effect.parameters}


NO_EFFECTS = Effects()
"""Effects of a scene that declares none."""


def parameters_with(base: Parameters, effects: Iterable[Effect]) -> Parameters:
    """Return the parameters of a model with some effects, each once."""
    by_name = {parameter.name: parameter for parameter in base.declared}
    for effect in effects:
        by_name |= {parameter.name: parameter for parameter in effect.parameters if parameter.name not in by_name}
    return Parameters(*by_name.values())
