"""`view` and `live_part`: a solution as a page that computes again while one drags."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidModel, InvalidSetting, require_kind, require_package
from servocore.files import require_places, write_together
from servocore.formulations.reduced import Reduced
from servocore.model.drawing import picture_of
from servocore.model.limits import run_quantities
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Parameter
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.problem import Problem
from servocore.solution import Solution
from servocore.stepping.observation import observed
from servocore.view.javascript import written
from servocore.view.live_model import LiveModel, live_model, packed, path_of

WEB = files("servocore.view").joinpath("web")
_SCRIPTS = ("numbers.js", "scene.js", "plots.js", "controls.js", "page.js")
_MOST_ROWS = 2001
_SHOWN, _FIRST = ("swing", "tension"), 3
_STEP_PARTS = 200
_AT_REST = 1e-9  # of a derivative, relative to the largest of its order


@dataclass(frozen=True, eq=False)
class LivePart:
    """The live part of a page, to be put into any page: it needs nothing else.

    Attributes
    ----------
    style : str
        Content of a ``<style>``.
    body : str
        The elements, and the scripts that fill them.
    title : str
        Name of the system.
    live : bool
        Whether the page computes; else it shows the solution as it is.
    why : str
        Why it does not compute, as part of a sentence; empty where it does.
    """

    style: str
    body: str
    title: str
    live: bool
    why: str


def view(
    solution: Solution, path: str | Path | None = None, *, scene: Scene | None = None, model: str | None = None
) -> Path:
    """Write a solution as one HTML file: the system in space and moving, plots, and sliders that compute it again.

    Parameters
    ----------
    solution : Solution
        From `solve`.
    path : str or Path, optional
        The file, whose name ends with ``.html``; it needs no other and no network. The scene's name, such as
        ``rotary_crane.html`` in the current folder, when not given.
    scene : Scene, optional
        The scene, for solutions without an origin: from files, or from a user's routes.
    model : str, optional
        Model of that scene; its smallest when not given.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidSetting
        If the file cannot be written or has another ending, the solution has no origin and no scene
        is given, or the package Jinja2 is not installed.
    InvalidModel
        If the drawing of the scene cannot be drawn, or something that it reports is no finite number.

    Examples
    --------
    >>> import servocore as sc
    >>> sc.view(sc.solve(sc.scenes.rotary_crane()), "crane.html").name
    'crane.html'
    """
    file = require_page(path or f"{_problem(solution, scene, model).name}.html")
    write_together({file: page_text(solution, live_part(solution, scene=scene, model=model))})
    return file


def page_text(solution: Solution, part: LivePart) -> str:
    """Return a page with nothing but a live part."""
    return str(_template("page.html.j2").render(part=part, route=solution.route))


def require_page(path: str | Path) -> Path:
    """Return where a page goes; raises `InvalidSetting` if it cannot be made or written there."""
    require_package("jinja2", "report")
    file = Path(path)
    if file.suffix.lower() not in (".html", ".htm"):
        raise InvalidSetting(f"cannot write {file}: the name of a page ends with .html")
    require_places({"the page": file})
    return file


def live_part(solution: Solution, *, scene: Scene | None = None, model: str | None = None) -> LivePart:
    """Return the live part of a page: the same as `view` writes, to be put into a page of one's own.

    Parameters
    ----------
    solution : Solution
        From `solve`.
    scene : Scene, optional
        The scene, for solutions without an origin.
    model : str, optional
        Model of that scene; its smallest when not given.

    Returns
    -------
    LivePart
        Style and elements, with the scripts that fill them.

    Raises
    ------
    InvalidSetting, InvalidModel
        As `view`.
    """
    problem = _problem(solution, scene, model)
    live, why = _live(problem, solution)
    about, source = _written(problem, solution, live)
    title = problem.name.replace("_", " ")
    scripts = [WEB.joinpath(script).read_text(encoding="utf-8") for script in _SCRIPTS]
    style = WEB.joinpath("live.css").read_text(encoding="utf-8")
    body = _template("live.html.j2").render(
        about=json.dumps(about, separators=(",", ":"), allow_nan=False).replace("</", "<\\/"),
        source=",\n".join(f"{name}:{text}" for name, text in source.items()),
        scripts="\n".join(scripts),
        live=live is not None,
        stepped=bool(about["steps"]),
        flat=about["flat"],
        why=why,
        title=title,
    )
    return LivePart(style, body, title, live is not None, why)


def _live(problem: Problem, solution: Solution) -> tuple[LiveModel | None, str]:
    """Return the live model of a page, or the reason why there is none."""
    try:
        live = live_model(problem)
    except InvalidModel as error:
        return None, str(error)
    t = solution.t[_thinned(solution.t)]
    gap = _undefined(t, dict(zip((quantity.name for quantity in live.outputs), live.values(problem, t).T, strict=True)))
    return (None, f"its formulas give {gap}") if gap else (live, "")


def _undefined(t: Array, rows: Mapping[str, Array]) -> str:
    """Return which quantity is first not finite, and when; empty if all are finite."""
    gaps = [(int(np.argmin(finite)), name) for name, row in rows.items() if not (finite := np.isfinite(row)).all()]
    return f"no {min(gaps)[1]} at t = {t[min(gaps)[0]]:.6g} s" if gaps else ""


def _problem(solution: Solution, scene: Scene | None, model: str | None) -> Problem:
    require_kind(solution, Solution, "the view", "a Solution, as solve returns it", InvalidSetting)
    if scene is not None:
        return Problem.of(scene, model)
    if not isinstance(solution.origin, Problem):
        raise InvalidSetting("a solution from a file has no origin: give its scene, view(solution, path, scene=scene)")
    return solution.origin


def _template(name: str) -> Any:
    require_package("jinja2", "report")
    import jinja2  # noqa: PLC0415 - an optional dependency

    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(WEB.joinpath(name).read_text(encoding="utf-8"))


# Data of the page ----------------------------------------------------------------------------------------------------


def _written(problem: Problem, solution: Solution, live: LiveModel | None) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the data of the page, and its functions as JavaScript."""
    t = _thinned(solution.t)
    known = tuple(quantity for quantity, _ in observed(problem.system) if quantity.name in solution)
    quantities = live.outputs if live else known
    rows = {quantity.name: solution[quantity.name][t] for quantity in quantities if quantity.name in solution}
    times, system = solution.t[t], problem.system
    if live is not None and not _is_exact(problem, solution, live):
        rows = dict(zip((quantity.name for quantity in quantities), live.values(problem, times).T, strict=True))
    gap = _undefined(times, rows)
    if gap:
        raise InvalidModel(f"{problem.name} has {gap}, and a page shows finite numbers only")
    orders = live.orders if live else 1
    path, laws = path_of(problem.reference, _refined(times) if live else times, orders)
    steps = live.steps if live and _can_march(problem, times, orders) else None
    picture = picture_of(system, quantities, problem.drawing)
    points = written("points", [picture.reported, system.p], [picture.coordinates])
    names = [quantity.name for quantity in quantities]
    added_up = run_quantities(quantities)
    shown = *quantities, *added_up
    rows |= {each.name: each.course(times, each.integrand(rows[each.of])) for each in added_up}
    source = {"points": points, **laws, **(live.source if live else {})}
    limits, path_limits = _limits(problem, [each.name for each in shown])
    if live and path_limits:
        source["path_limits"] = _path_limits(problem, orders)
    about = {
        "name": problem.name,
        "live": live is not None,
        "rows": system.gamma.size1(),
        "orders": orders,
        "path": path,
        "components": [_quantity(quantity) for quantity in system.outputs],
        "outputs": [
            {**_quantity(quantity), "wraps": quantity.wraps, "input": quantity in system.inputs,
             "nonnegative": quantity.never_negative, "inner": _is_inner(system, quantity)}
            for quantity in shown
        ],
        "added_up": [{"of": names.index(each.of), "rms": each.rms} for each in added_up],
        "shown": _shown(system, names),
        "parameters": [
            {**_quantity(each), "value": float(value), "lower": _finite(each.lower), "upper": _finite(each.upper)}
            for each, value in zip(system.parameters.declared, problem.p, strict=True)
        ],
        "limits": limits,
        "path_limits": path_limits if live else [],
        "steps": steps or None,
        "step": problem.reference.duration / _STEP_PARTS,
        "solved": {"t": packed(times), "values": packed(np.stack([rows[each.name] for each in shown]))},
        **picture.about(),
    }  # fmt: skip
    return about, source


def _thinned(t: Array) -> npt.NDArray[np.intp]:
    """Return which instants are written: all, or some two thousand among them, evenly apart if their number allows."""
    last = len(t) - 1
    stride = -(-last // (_MOST_ROWS - 1))
    even = [divisor for divisor in range(stride, 2 * stride) if last % divisor == 0]
    if even or stride <= 1:
        return np.arange(0, last + 1, even[0] if even else 1)
    return np.unique(np.linspace(0, last, _MOST_ROWS).round().astype(np.intp))


def _refined(t: Array) -> Array:
    """Return instants of a table of the path: those that are written, and if they are few, some between them."""
    parts = (_MOST_ROWS - 1) // (len(t) - 1)
    between = t[:-1, None] + np.diff(t)[:, None] * np.arange(parts) / parts
    return np.append(between.ravel(), t[-1])


def _is_exact(problem: Problem, solution: Solution, live: LiveModel) -> bool:
    """Whether a solution is an exact inversion, so that the page compares its numbers with it."""
    return solution.route == problem.dae(Reduced()).name and all(quantity.name in solution for quantity in live.outputs)


def _can_march(problem: Problem, t: Array, orders: int) -> bool:
    """Whether the scheme of the paper can start: from rest, on instants that are evenly apart."""
    jet = problem.reference.jet(t, orders - 1)[:, 1:, : len(problem.system.outputs)]
    size = np.abs(jet).max(axis=(0, 2)) + 1e-300
    rests = bool((np.abs(jet[0]).max(axis=1) <= _AT_REST * size)[:2].all())
    return rests and bool(np.ptp(np.diff(t)) <= 1e-6 * (t[-1] - t[0]) / len(t))


def _quantity(each: Quantity | Parameter) -> dict[str, Any]:
    return {"name": each.name, "unit": each.unit, "description": each.description}


def _shown(system: MechanicalSystem, names: list[str]) -> list[int]:
    """Return which quantities are plotted at first, beside the inputs: swing and tension, or the first few."""
    others = [k for k in range(len(names)) if k >= len(system.inputs)]
    return [k for k in others if names[k] in _SHOWN] or others[:_FIRST]


def _is_inner(system: MechanicalSystem, each: Quantity) -> bool:
    """Whether a quantity is a redundant coordinate, which is listed apart."""
    reported = [*system.inputs, *system.outputs, *system.observables]
    return bool(system.lam.numel() and system.observables) and each.unit in ("1", "m") and each not in reported


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _limits(problem: Problem, names: list[str]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the limits of reported quantities, and those of the path alone."""
    of_motion = [
        {
            "output": names.index(limit.reported),
            "low": _finite(limit.bound),
            "high": _finite(limit.upper),
            "rate": limit.rate,
        }
        for limit in problem.limits
        if limit.reported in names
    ]
    of_path = [{"quantity": limit.quantity, "reason": limit.reason} for limit in problem.path_limits]
    return of_motion, of_path


def _path_limits(problem: Problem, orders: int) -> str:
    """Return (path, parameters) -> how far each limit of the path is, positive where it is kept, as JavaScript."""
    system = problem.system
    margins = [limit.on(system) - limit.bound for limit in problem.path_limits]
    return written("path_limits", [system.gamma[:, :orders], system.p], [ca.vertcat(*margins)])
