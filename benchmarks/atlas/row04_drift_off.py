"""Row 4: constraints that are differentiated and then forgotten drift away."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, long_march, slope
from benchmarks.atlas.style import label, legend_below, panels
from benchmarks.route_styles import FAILING, line_style
from servocore import periodic
from servocore.stepping.forward_dynamics import STABILIZATION_RATE

NAME = "drift-off"
STEP = 0.004
CHUNK = 10_000
AMPLITUDE = 1.0
"""Of the free swing, in rad."""
PERIOD = 2.56
"""Of the path that the mass follows in the inverse problem, in s: 640 steps."""


@cache
def pendulum() -> sc.MechanicalSystem:
    """Return a mass of 1 kg on a rod of 1 m in coordinates x, z: one constraint, a horizontal force on the mass."""
    coordinates = sc.Coordinates(sc.Quantity("x", "m"), sc.Quantity("z", "m"))
    x, z = ca.vertsplit(coordinates.q)
    gamma = ca.SX.sym("gamma", 1, 25)
    return sc.MechanicalSystem(
        name="pendulum",
        coordinates=coordinates,
        parameters=sc.Parameters(),
        inputs=(sc.Quantity("F", "N"),),
        outputs=(sc.Quantity("y", "m"),),
        mass=ca.sparsify(ca.SX.eye(2)),
        potential=9.81 * z,
        constraints=(x**2 + z**2 - 1) / 2,
        input_matrix=ca.SX([[-1.0, 0.0]]),
        output=x,
        gamma=gamma,
        guess=ca.vertcat(gamma[0, 0], -ca.sqrt(1 - gamma[0, 0] ** 2)),
        home=(0.3,),
    )


def scene(cycles: int) -> sc.Scene:
    """Return the pendulum whose mass follows x = 0.5 sin(2 pi t / PERIOD) m."""
    path = periodic((0.0,), [[0.0]], [[0.5]], PERIOD, cycles)
    return sc.Scene(name="pendulum", models={"points": pendulum}, reference=path)


def one_step(rate: float, project: bool) -> ca.Function:
    """Return a step of the classical Runge-Kutta method on the free pendulum with g'' + 2 a g' + a^2 g = 0.

    `rate` is a; zero leaves the index-1 equations as differentiation made them. `project` makes them those of index 2
    with g' = 0 held exactly, by an orthogonal projection of the velocities after every step.
    """
    system = pendulum()
    state = ca.vertcat(system.q, system.v)
    g_dot = ca.mtimes(system.G, system.v)
    stabilized = ca.jtimes(g_dot, system.q, system.v) + 2 * rate * g_dot + rate**2 * system.constraints
    matrix = ca.blockcat([[system.mass, system.G.T], [system.G, ca.SX(1, 1)]])
    found = -ca.solve(matrix, ca.vertcat(system.bias, stabilized))
    field = ca.Function("field", [state], [ca.vertcat(system.v, found[:2])])
    k1 = field(state)
    k2 = field(state + STEP / 2 * k1)
    k3 = field(state + STEP / 2 * k2)
    k4 = field(state + STEP * k3)
    end = state + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    if project:
        q, v = end[:2], end[2:]
        end = ca.vertcat(q, v - q * ca.dot(q, v) / ca.sumsqr(q))
    return ca.Function("step", [state], [end])


def free_swing(step: ca.Function, steps: int) -> tuple[Array, Array, Array]:
    """Return times and the largest |g| and |g'| of every chunk of steps."""
    loop = step.mapaccum(CHUNK)
    state = np.array([np.sin(AMPLITUDE), -np.cos(AMPLITUDE), 0.0, 0.0])
    g, g_dot = [], []
    for _ in range(steps // CHUNK):
        states = np.asarray(loop(state))
        g.append(np.abs((states[:2] ** 2).sum(axis=0) - 1).max() / 2)
        g_dot.append(np.abs((states[:2] * states[2:]).sum(axis=0)).max())
        state = states[:, -1]
    return STEP * CHUNK * np.arange(1, len(g) + 1, dtype=np.float64), np.array(g), np.array(g_dot)


def measure(quick: bool) -> Findings:
    """Let it swing for a million steps; then follow a path for as many with the forms of this library."""
    found = Findings(NAME)
    steps = 100_000 if quick else 1_000_000
    for name, rate, project, power in (
        ("index 1: g'' = 0, RK4", 0.0, False, 2.0),
        ("index 2: g' = 0, RK4", 0.0, True, 1.0),
        (f"index 1 stabilized: a = {STABILIZATION_RATE:g}/s, RK4", STABILIZATION_RATE, False, 0.0),
    ):
        t, g, _ = free_swing(one_step(rate, project), steps)
        found.curves[name] = (t, g)
        late = len(t) // 2
        growth, where = slope(t[late:], g[late:]), f"{steps:.0e} steps"
        verdict = FAILS if power else SURVIVES
        found.add("pendulum, free", name, "power of t with which |g| grows", where, about(power, 0.15), growth, verdict)
        bound = at_least(1e-9) if power else at_most(1e-6)
        found.add("pendulum, free", name, "|g| at the end [m2]", where, bound, g[-1], verdict)
        found.facts[f"index{name[6]}" if power else "stabilized"] = g[-1]
    _simulated(found)
    _followed(found, 20_000 if quick else steps)
    found.facts.update(steps=steps, step_ms=STEP * 1e3)
    return found


def _simulated(found: Findings) -> None:
    """Run the library's forward dynamics, which are stabilized, for a minute of swinging."""
    t = np.linspace(0.0, 60.0, 601)
    free = sc.simulate(scene(24), lambda _: np.zeros(1), t=t)
    worst = free.statistics.constraint_violation
    found.add("pendulum, free", "sc.simulate", "|g| over 60 s [m2]", f"a = {STABILIZATION_RATE:g}/s", at_most(1e-8),
              worst, SURVIVES)  # fmt: skip
    found.facts["simulate"] = worst


def _followed(found: Findings, steps: int) -> None:
    subject = scene(-(-steps // 640) + 20)
    for form, method in ((sc.Projected(), sc.BackwardEuler()), (sc.Projected(), sc.BDF(3)), (sc.Reduced(), sc.BDF(1))):
        stepper = sc.Stepper(subject, form, method, STEP)
        name = form.name if form == sc.Reduced() else f"{form.name}, {method.name}"
        worst = np.array([chunk.violations[2].max() for chunk in long_march(stepper, steps, CHUNK)])
        t = STEP * CHUNK * np.arange(1, len(worst) + 1)
        found.curves[name] = (t, np.maximum(worst, 1e-17))
        found.add("pendulum, x prescribed", name, "largest |g| of the last 10000 steps [m2]", f"{steps:.0e} steps",
                  at_most(1e-13), worst[-1], SURVIVES)  # fmt: skip
        found.facts["held"] = max(found.facts.get("held", 0.0), worst.max())


_INDEX_REDUCED = (
    {"color": FAILING, "ls": "-", "marker": "x"},
    {"color": "#6d0a1f", "ls": "--", "marker": "+"},
    {"color": "#7f7f7f", "ls": "-.", "marker": ">"},
)
"""How the lowered equations are drawn, in their order: those that drift, and the stabilized ones."""


def draw(found: Findings) -> Figure:
    """Constraint violation over time."""
    figure, ax = panels(1, width=5.6, height=3.2)
    lowered, sizes = iter(_INDEX_REDUCED), iter((9.0, 6.0, 3.0))  # three routes on one line
    for name, (t, g) in found.curves.items():
        line = next(lowered) if name.startswith("index") else line_style(name, ms=next(sizes))
        ax.loglog(t, g, label=name, markevery=0.12, **line)
    label(ax, "time (s)", "$|g|$ (m²)", "pendulum: violation of the rod's length")
    legend_below(figure, ax, columns=2)
    return figure


ROW = Row(
    name=NAME,
    title="Drift-off after index reduction",
    avoid="integrating differentiated constraints (g'' = 0 or g' = 0) without stabilization",
    do="`Projected()` or `Reduced()`, which satisfy the constraints themselves; `simulate`, which stabilizes them",
    theory="Every step commits a small error in g''. With g'' = 0 (index 1) the violation g grows quadratically in"
    " time, with g' = 0 (index 2) linearly. Baumgarte's g'' + 2 a g' + a² g = 0 damps it at the rate a.",
    survivor="Projected and reduced forms satisfy g = 0 in every step: |g| is at most {held:.0e} m² after {steps:.0e}"
    " steps.",
    limit="Stabilized with a = 10/s, RK4 at {step_ms:.0f} ms settles at {stabilized:.1e} m² (`simulate`, with step"
    " control: below {simulate:.0e} m²); without stabilization the violation reaches {index1:.1e} m² (index 1) and"
    " {index2:.1e} m² (index 2).",
    caption="Largest violation of the rod's length in every 10000 steps.",
    measure=measure,
    draw=draw,
)
