"""The rows of the atlas, in the order of the page."""

from __future__ import annotations

from benchmarks.atlas import (
    row01_original_form,
    row02_undamped_methods,
    row03_inconsistent_start,
    row04_drift_off,
    row05_rough_references,
    row06_singular_configurations,
    row07_stability_map,
    row08_unstable_internal_dynamics,
    row09_noisy_references,
    row10_redundant_constraints,
    row11_variable_steps,
    row12_long_runs,
    row13_elastic_bar,
    row14_conserved_quantities,
    row15_flexible_rope,
)
from benchmarks.atlas.record import Findings, Row

ROWS: tuple[Row, ...] = tuple(
    module.ROW
    for module in (
        row01_original_form,
        row02_undamped_methods,
        row03_inconsistent_start,
        row04_drift_off,
        row05_rough_references,
        row06_singular_configurations,
        row07_stability_map,
        row08_unstable_internal_dynamics,
        row09_noisy_references,
        row10_redundant_constraints,
        row11_variable_steps,
        row12_long_runs,
        row13_elastic_bar,
        row14_conserved_quantities,
        row15_flexible_rope,
    )
)


def named(name: str) -> Row:
    """Return the row of this name; raises KeyError if there is none."""
    return {row.name: row for row in ROWS}[name]


def measured(name: str, quick: bool) -> Findings:
    """Measure a row, perhaps in a process of its own."""
    return named(name).measure(quick)
