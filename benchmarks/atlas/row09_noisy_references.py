"""Row 9: measured positions with noise, and what becomes of it in inputs that need four derivatives."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import servocore as sc
from benchmarks.atlas.record import FAILS, REFUSED, SURVIVES, Findings, Row, about, at_least, at_most
from benchmarks.atlas.runs import Array, quietly, slope
from benchmarks.atlas.style import GOOD, label, legend_below, panels
from benchmarks.route_styles import line_style
from servocore.references.bspline import Ends, fit, interpolation_knots, to_path

NAME = "noisy-references"
NOISE = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
"""Standard deviation of every coordinate of every sample, in m."""
UNGUARDED = (1e-9, 1e-8, 1e-7, *NOISE)
"""The same for splines through every sample, which need less to be useless."""
SAMPLES = 401
SEED = 20_240_601
STEP = 0.05
TOLERANCE = 5.0
"""Tolerance given to `sampled`, in standard deviations of a coordinate."""
ROUTES = ((sc.Reduced(), sc.BackwardEuler()), (sc.Projected(), sc.BackwardEuler()), (sc.Projected(), sc.RadauIIA(3)),
          (sc.Original(), sc.BackwardEuler()))  # fmt: skip


def true_scene() -> sc.Scene:
    """Return the rotary crane on its default way in a time law of degree 13."""
    path = sc.rest_to_rest((5.0, 0.0, -5.0), (-2.0, 2.0, -2.0), 20.0, sc.DEGREE13)
    return sc.scenes.rotary_crane().with_reference(path)


def samples(sigma: float) -> tuple[Array, Array]:
    """Return times and noisy positions, shape (SAMPLES, 3); only the size of the noise depends on sigma."""
    t = np.linspace(0.0, 20.0, SAMPLES)
    noise = np.random.default_rng(SEED).standard_normal((SAMPLES, 3))
    return t, true_scene().reference.jet(t, 0)[:, 0] + sigma * noise


def unguarded(t: Array, positions: Array) -> sc.Reference:
    """Return the spline of degree 9 through every sample, without the checks of `sampled`."""
    free = Ends(start=False, end=False)
    return to_path(fit(t, positions, interpolation_knots(t, free), free), free, None)


def input_error(reference: sc.Reference, form: sc.Formulation, method: sc.Method, name: str = "M_b") -> float:
    """Largest error of an input against the true path, relative to its peak; infinity where there is no answer."""
    scene = true_scene()
    try:
        solution = quietly(scene.with_reference(reference), form, method, step=STEP)
    except sc.ServocoreError:
        return np.inf
    exact = scene.exact(solution.t)[name]
    return float(np.abs(solution[name] - exact).max() / np.abs(exact).max())


def measure(quick: bool) -> Findings:
    """Feed noise of several sizes, unguarded and fitted, to the forms."""
    found = Findings(NAME)
    peak = float(np.abs(true_scene().exact(np.linspace(0.0, 20.0, 401))["M_b"]).max())
    paths = {sigma: unguarded(*samples(sigma)) for sigma in UNGUARDED}
    for form, method in ROUTES[:2] if quick else ROUTES:
        _unguarded(found, paths, form, method, peak)
    _spacing(found)
    for sigma in NOISE:
        _guarded(found, sigma)
    fitted = np.array([found.curves["fitted"][sigma] for sigma in NOISE])
    usable = [sigma for sigma, error in zip(NOISE, fitted, strict=True) if error < 0.05]
    found.facts.update(usable=max(usable), fitted_best=fitted[0], fitted_worst=fitted[-1])
    return found


def _unguarded(
    found: Findings, paths: dict[float, sc.Reference], form: sc.Formulation, method: sc.Method, peak: float
) -> None:
    route = form.name if form == sc.Reduced() else f"{form.name}, {method.name}"
    clean = input_error(unguarded(*samples(0.0)), form, method)
    errors = np.array([input_error(paths[sigma], form, method) for sigma in UNGUARDED])
    found.curves["unguarded", route] = errors
    linear = np.flatnonzero(np.isfinite(errors) & (errors > 3.0 * clean))[:3]
    sigma = np.array(UNGUARDED)[linear]
    found.add("rotary_crane", f"interpolated, {route}", "power of the noise in the input error",
              f"{sigma[0]:g} ... {sigma[-1]:g} m", about(1.0, 0.35), slope(sigma, errors[linear]), FAILS)  # fmt: skip
    factor = errors[linear[0]] * peak / sigma[0]
    found.add("rotary_crane", f"interpolated, {route}", "amplification [N m per m]", f"h = {STEP:g} s",
              at_least(1e6), factor, FAILS)  # fmt: skip
    found.facts[f"amplification_{form.name}_{method.name.replace('-', '_')}"] = factor
    lost = "no answer" if np.isinf(errors[-1]) else "an answer"
    found.add("rotary_crane", f"interpolated, {route}", "answer", f"noise {NOISE[-1]:g} m", "no answer", lost, REFUSED)


def _spacing(found: Findings) -> None:
    """Compare what the same noise does to splines through samples that lie at different distances."""
    counts, sigma = (101, 201, 401), 1e-10
    scene, peaks = true_scene(), []
    for count in counts:
        t = np.linspace(0.0, 20.0, count)
        clean = scene.reference.jet(t, 0)[:, 0]
        noise = sigma * np.random.default_rng(SEED).standard_normal(clean.shape)
        with_noise, without = (
            quietly(scene.with_reference(unguarded(t, clean + each)), step=STEP)["M_b"] for each in (noise, 0.0 * noise)
        )
        peaks.append(float(np.abs(with_noise - without).max()))
    rate = slope(20.0 / (np.array(counts) - 1.0), np.array(peaks))
    found.add("rotary_crane", "interpolated, reduced", "exponent of the noise's effect in the sample spacing",
              f"{counts[0]} ... {counts[-1]} samples", about(-4.0, 0.6), rate, FAILS)  # fmt: skip


def _guarded(found: Findings, sigma: float) -> None:
    t, positions = samples(sigma)
    try:
        sc.sampled(t, positions)
        seen = "nothing"
    except sc.InvalidReference as error:
        seen = type(error).__name__
    found.add(
        "rotary_crane", "sampled, no tolerance", "noisy samples", f"{sigma:g} m", "InvalidReference", seen, REFUSED
    )
    path = sc.sampled(t, positions, tolerance=TOLERANCE * sigma)
    wrong = input_error(path, sc.Reduced(), sc.BackwardEuler())
    found.curves.setdefault("fitted", {})[sigma] = wrong
    found.curves.setdefault("fit_error", {})[sigma] = path.fit_error
    bound = {1e-6: 1e-3, 1e-5: 1e-2, 1e-4: 5e-2}.get(sigma)
    found.add("rotary_crane", "sampled with tolerance, reduced", "error of M_b / peak", f"noise {sigma:g} m",
              at_least(0.02) if bound is None else at_most(bound), wrong,
              FAILS if bound is None else SURVIVES)  # fmt: skip


def draw(found: Findings) -> Figure:
    """Input error over noise."""
    figure, (left, right) = panels(2, height=3.0)
    for key, errors in found.curves.items():
        if key[0] == "unguarded":
            known = np.where(np.isfinite(errors), errors, np.nan)
            left.loglog(
                UNGUARDED, known, label=f"interpolated, {key[1]}", **line_style(key[1], markerfacecolor="white")
            )
    fitted = [found.curves["fitted"][sigma] for sigma in NOISE]
    left.loglog(NOISE, fitted, label="sampled with tolerance, reduced", **line_style("reduced"))
    left.axhline(1.0, color="0.5", lw=0.7)
    label(left, "noise of the samples (m)", "error of $M_b$ / peak", f"{SAMPLES} samples in 20 s")
    errors = [found.curves["fit_error"][sigma] for sigma in NOISE]
    right.loglog(NOISE, errors, color=GOOD, marker="s", label="fit_error of the path")
    right.loglog(NOISE, NOISE, "k:", lw=0.8, label="noise")
    label(right, "noise of the samples (m)", "distance (m)", "how far the fit stays from samples")
    legend_below(figure, left, right)
    return figure


ROW = Row(
    name=NAME,
    title="Noise in the reference",
    avoid="splines through measured positions",
    do="`sampled(t, positions, tolerance=...)` with a tolerance of some standard deviations of the noise",
    theory="Noise σ in samples at spacing Δt becomes a multiple of σ/Δt⁴ in the fourth derivative of an interpolating"
    " curve, and so in the inputs: finer sampling makes it worse, whatever the formulation.",
    survivor="`sampled` refuses noisy samples without a tolerance; with one it fits the fewest pieces: torque"
    " accurate to {fitted_best:.0e} of its peak at a noise of 1 µm, within 5 % up to {usable:g} m. `fit_error`"
    " estimates the noise.",
    limit="Interpolated, noise is amplified by {amplification_reduced_backward_euler:.0e} N m/m (reduced) and"
    " {amplification_projected_backward_euler:.0e} N m/m (projected, h = 50 ms). With a tolerance the error reaches"
    " {fitted_worst:.0%} at a noise of 1 cm.",
    caption="Left: error of the torque; lines end where the noise makes the rope slack. Right: the fit's own estimate"
    " of its distance from the samples.",
    measure=measure,
    draw=draw,
)
