"""Row 1: the original form of index 5, whose inputs are divided by h^4."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, amplified, error_at, slope
from benchmarks.atlas.style import label, legend_below, panels
from benchmarks.route_styles import line_style
from servocore.references.profiles import polynomial

NAME = "original-form"
FORMS = (sc.Original(), sc.Projected(), sc.Reduced())
STEPS = {
    "cars": (40, 100, 400, 1000, 2000, 4000, 10_000, 20_000, 40_000, 80_000, 160_000, 400_000),
    "rotary_crane": (50, 100, 400, 1000, 4000, 10_000, 20_000, 40_000, 80_000, 160_000),
}
QUICK = {"cars": (400, 4000, 20_000, 40_000)}
FLOOR_STEPS = (4000, 10_000, 20_000, 40_000, 100_000)
SMOOTH = polynomial(17)
"""C^8: the discretization error of BDF4 disappears, and what is left is round-off."""
ROUND_OFF = 2.0**-52


def measure(quick: bool) -> Findings:
    """Scan the step on both scenes with all three forms and backward Euler."""
    found = Findings(NAME)
    for name, steps in (QUICK if quick else STEPS).items():
        scene = sc.scenes.REGISTRY[name]()
        h = scene.reference.duration / np.array(steps)
        errors = {
            form.name: np.array([error_at(scene, form, sc.BackwardEuler(), count) for count in steps]) for form in FORMS
        }
        found.curves[name] = (h, errors)
        _judge(found, name, h, errors)
    _projected_floor(found)
    return found


def _projected_floor(found: Findings) -> None:
    """Make the discretization error small, and see the round-off of the projected form grow."""
    cars = sc.scenes.cars()
    smooth = cars.with_reference(sc.rest_to_rest((0.0,), (1.0,), cars.reference.duration, SMOOTH))
    h = cars.reference.duration / np.array(FLOOR_STEPS)
    errors = np.array([error_at(smooth, sc.Projected(), sc.BDF(4), count) for count in FLOOR_STEPS])
    rate = slope(h, errors)
    found.add("cars", "projected, bdf4, path of degree 17", "exponent of the input error in h, small h",
              f"h <= {h[0]:.0e} s", about(-2.0, 0.4), rate, SURVIVES)  # fmt: skip
    found.add("cars", "projected, bdf4, path of degree 17", "relative input error", f"h = {h[0]:.0e} s",
              at_most(1e-7), errors[0], SURVIVES)  # fmt: skip
    found.facts.update(projected_floor=float(np.median(errors * h**2) / ROUND_OFF), projected_floor_rate=rate)
    found.curves["floor"] = (h, errors)


def _judge(found: Findings, name: str, h: Array, errors: dict[str, Array]) -> None:
    original, projected, reduced = (errors[form.name] for form in FORMS)
    best = int(original.argmin())
    # Amplified round-off: from where it has risen well above the least error on, as long as steps are solved at all.
    grown = amplified(original)
    rate = slope(h[grown], original[grown])
    route = "original, backward-euler"
    found.add(name, route, "exponent of the input error in h, small h", f"h <= {h[grown[0]]:.2g} s",
              about(-4.0, 0.6), rate, FAILS)  # fmt: skip
    found.add(name, route, "relative input error", f"h = {h[-1]:.2g} s", at_least(0.5), original[-1], FAILS)
    found.add(name, route, "least relative input error", f"h = {h[best]:.2g} s", at_least(5e-4), original[best], FAILS)
    last = min(best + 1, len(h) - 1)
    first_order = slope(h[:last], projected[:last])
    route = "projected, backward-euler"
    found.add(name, route, "exponent of the input error in h", f"h >= {h[last - 1]:.2g} s", about(1.0, 0.1),
              first_order, SURVIVES)  # fmt: skip
    found.add(name, route, "least relative input error", f"h = {h[projected.argmin()]:.2g} s",
              at_most(3e-3 if name == "rotary_crane" else 3e-4), projected.min(), SURVIVES)  # fmt: skip
    found.add(name, "reduced", "relative input error, any step", f"h >= {h[-1]:.2g} s", at_most(1e-12),
              reduced.max(), SURVIVES)  # fmt: skip
    floor = original[grown] * h[grown] ** 4 / ROUND_OFF
    found.facts.update({
        f"{name}_rate": rate, f"{name}_best": original[best], f"{name}_best_h": h[best], f"{name}_last": original[-1],
        f"{name}_reduced": reduced.max(), f"{name}_projected": projected.min(),
        f"{name}_projected_h": h[projected.argmin()], f"{name}_floor": float(np.median(floor)),
    })  # fmt: skip


def draw(found: Findings) -> Figure:
    """Input error over step, one panel a scene."""
    figure, axes = panels(2, sharey=True, height=3.0)
    titles = {"cars": "two cars", "rotary_crane": "rotary crane, points"}
    for ax, name in zip(axes, titles, strict=True):
        h, errors = found.curves[name]
        for form, values in errors.items():
            words = form if form == "reduced" else f"{form}, backward-euler"
            ax.loglog(h, values, label=words, **line_style(words))
        guide = h[h < 3e-3]
        ax.loglog(guide, found.facts[f"{name}_floor"] * ROUND_OFF / guide**4, "k:", lw=0.8, label="$h^{-4}$")
        if name == "cars":
            ax.loglog(*found.curves["floor"], label="projected, bdf4, path of degree 17", **line_style("bdf4"))
        label(ax, "step $h$ (s)", "largest input error / peak" if ax is axes[0] else "", titles[name])
    legend_below(figure, *axes)
    return figure


ROW = Row(
    name=NAME,
    title="Original equations at small steps",
    avoid="`Original()` (index 5), and smaller steps as a remedy",
    do="`Reduced()`, the default of `solve`; `Projected()` where a step method is wanted",
    theory="Backward Euler on the original equations forms inputs as fourth differences of positions: round-off ε"
    " becomes ε/h⁴, while the discretization error falls like h. The projected form divides by h², the reduced form"
    " by no step.",
    survivor="`Reduced()`: {cars_reduced:.1e} (cars) and {rotary_crane_reduced:.1e} (crane) at every h. `Projected()`"
    " stays of first order.",
    limit="The original form reaches {cars_best:.1e} (cars, h = {cars_best_h:.1e} s) and {rotary_crane_best:.1e}"
    " (crane, h = {rotary_crane_best_h:.1e} s) at best, with a round-off level of {cars_floor:.1g} ε/h⁴ of the peak"
    " on the cars; projected {cars_projected:.1e} at h = {cars_projected_h:.0e} s, with {projected_floor:.1g} ε/h²"
    " (ε = 2.2e-16, h in s).",
    caption="Largest input error relative to the input's peak against the step, backward Euler.",
    measure=measure,
    draw=draw,
)
