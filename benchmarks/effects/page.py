"""The page docs/effects/index.md."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import astuple, fields

import numpy as np

from benchmarks.effects.cases import DURATIONS
from benchmarks.effects.fresh import DRAWS, FACTOR, LENGTHS, SEED
from benchmarks.effects.fresh import DURATIONS as FRESH_DURATIONS
from benchmarks.effects.measure import NEAR, Pair, Verdict, shown_estimates
from servocore.effects.report import ESTIMATED, SIMULATED

Study = Mapping[str, Mapping[str, Sequence[float]]]

_TEXT = """# Effects: estimated and simulated

`servocore effects SCENE` and `sc.effects(scene)` estimate the tracking error that a neglected physical effect causes
([model levels](../model-levels.md), [decision 80](../decisions/0080-effects.md)): both models are
inverted along the same path, and the simpler model is driven by the input deficit. This page compares the estimates
with simulations of the plant. `make effects` writes it, its figures and [comparison.csv](comparison.csv), and fails if
of the estimates that are shown fewer than 95 % are within 10 %, or one lies on the other side of 1, 10 or 100 mm.

Filled marks are rows that `sc.effects` simulates automatically, for any tolerance. The estimate uses the model
without the effect to compute how the plant responds to the missing inputs. If the plant with the effect responds
differently (a second swing of a body below its hook, a shorter rope, drives that stick), terms of second order
matter. Both linear responses are computed beforehand at rest, at the start and at the end of the path; if they differ
by more than 10 %, the plant is simulated.

## Cranes for which the rule was designed

{count} combinations of effect, crane and duration: four cranes, {durations} s, position loops of 6 rad/s and damping 1
in every drive. Effects of index 5 run on the polynomial of degree 9, effects of index 7 on that of degree 13.

![estimated against simulated errors](comparison.png)

*Left: largest tracking error of the load during the motion. Right: the ratio, with 10 % shaded. Dashed: 1, 10
and 100 mm.*

{known}

## Random cranes

The rule was designed with the cranes above and one other random set, and fixed before this set was drawn: {fresh_count}
combinations, every crane {draws} times, with the seed {seed}. Every parameter of crane and effects (but gravity, the
air's density and the creep of friction) is its value times a factor between 1/{factor:g} and {factor:g}, the path a
straight line of {shortest:g} to {longest:g} m, the duration {quickest:g} to {slowest:g} s; durations and factors
evenly in their logarithms. Data: [fresh.csv](fresh.csv).

![estimated against simulated errors of random cranes](fresh.png)

{fresh}

## Comparison with an independent study

The rotary crane, and a big one of 2 t, were studied before in another program by forward simulation in steps of one or
two milliseconds. *Here / there*, in mm, {durations} s:

{study}

For effects of index 5 the largest difference with drives is {largest:.1f} % beyond the rounding of the figures there.
Changes of inputs agree to that rounding, and residual swings within a tenth or the rounding, but for those in wind:
there they count from how the rope leans at the start, here from how it leans at rest at the end. Where it says *other*
the two are not the same thing: there all rows ran on degree 9, which omits impulses at both ends for index 7, the rope
slid past eight nodes, and the load inertia followed the path with its centre of mass, which leaves an undamped internal
oscillation; here its centre of oscillation does.

Without drives, where no loop takes what a force lacks (*here / there*, mm; *lost* where the plant does not survive):

{open}

## Own inputs

Every plant is driven by its own exact inputs, without loops, along paths two derivatives smoother than it needs, over
{own_duration:g} s, by `sc.simulate` with a tolerance of 1e-12. The largest error of {own_count} plants
is {own_worst:.0e} mm ({own_name}): rounding.
"""


def table_of(pairs: Sequence[Pair]) -> str:
    """Return the pairs as a CSV file, lengths in mm."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([each.name for each in fields(Pair)])
    writer.writerows([f"{each:.6g}" if isinstance(each, float) else each for each in astuple(pair)] for pair in pairs)
    return text.getvalue()


def page(
    pairs: Sequence[Pair],
    fresh: Sequence[Pair],
    without_drives: Sequence[Pair],
    own: Sequence[tuple[str, str, float]],
    own_duration: float,
    study: Study,
    study_open: Study,
) -> str:
    """Return the page."""
    worst = max(own, key=lambda each: each[2])
    return _TEXT.format(
        count=len(pairs),
        durations=", ".join(f"{each:g}" for each in DURATIONS),
        known=_agreement(pairs),
        fresh=_agreement(fresh),
        fresh_count=len(fresh),
        draws=DRAWS,
        seed=SEED,
        factor=FACTOR,
        shortest=LENGTHS[0],
        longest=LENGTHS[1],
        quickest=FRESH_DURATIONS[0],
        slowest=FRESH_DURATIONS[1],
        study=_beside(pairs, study),
        open=_beside(without_drives, study_open),
        largest=100 * max(_beyond_rounding(here, there) for here, there in _index_five(pairs, study)),
        own_duration=own_duration,
        own_worst=worst[2],
        own_name=f"{worst[0]}, {worst[1]}",
        own_count=len(own),
    )


def _agreement(pairs: Sequence[Pair]) -> str:
    """Return what is to be said of a set of pairs."""
    shown = shown_estimates(pairs)
    ratios = np.quantile([each.ratio for each in shown], (0.05, 0.5, 0.95))
    far = [each for each in pairs if abs(each.ratio - 1) > NEAR]
    return "\n".join([
        f"* The {len(shown)} estimates that are shown: {Verdict.of(shown)}.",
        f"* Quantiles of their ratio at 5, 50 and 95 %: {', '.join(f'{each:.3f}' for each in ratios)}.",
        f"* All {len(pairs)} estimates, also those in whose place a simulation is shown: {Verdict.of(pairs)}.",
        f"* Farther than 10 %, and shown: {_listed(far, ESTIMATED)}.",
        f"* Farther than 10 %, and simulated: {_listed(far, SIMULATED)}.",
    ])  # fmt: skip


def _listed(pairs: Sequence[Pair], how: str) -> str:
    told = (
        f"{each.crane}, {each.effect}, {each.duration:.3g} s ({each.ratio:.2f})" for each in pairs if each.how == how
    )
    return "; ".join(told) or "none"


def _beyond_rounding(here: float, there: float) -> float:
    """Return the relative difference from a figure that was rounded to the last decimal it is written with."""
    decimals = len(f"{there:g}".partition(".")[2])
    return max(abs(here - there) - 0.5 * 10.0**-decimals, 0.0) / there


def _index_five(pairs: Sequence[Pair], study: Study) -> list[tuple[float, float]]:
    return [
        (each.simulated, study[each.crane][each.effect][DURATIONS.index(each.duration)])
        for each in pairs
        if each.crane in study and each.index == 5 and each.effect in study[each.crane]
    ]


def _beside(pairs: Sequence[Pair], study: Study) -> str:
    known = {(each.crane, each.effect, each.duration): each for each in pairs}
    lines = ["| effect | " + " | ".join(f"{crane}, {each:g} s" for crane in study for each in DURATIONS) + " | |",
             "|---" * (2 + len(study) * len(DURATIONS)) + "|"]  # fmt: skip
    for effect in next(iter(study.values())):
        cells, index = [], 5
        for crane, rows in study.items():
            for duration, there in zip(DURATIONS, rows[effect], strict=True):
                pair = known[crane, effect, duration]
                here = f"{pair.simulated:.3g}" if np.isfinite(pair.simulated) else "lost"
                cells.append(f"{here} / {there:g}")
                index = pair.index
        lines.append(f"| {effect} | " + " | ".join(cells) + f" | {'' if index == 5 else 'other'} |")
    return "\n".join(lines)


def pairs_of(text: str) -> list[Pair]:
    """Undo `table_of`, to the digits that it writes."""
    kinds = {"int": int, "float": float, "str": str}
    known = {field.name: kinds[str(field.type)] for field in fields(Pair)}
    return [
        Pair(**{name: known[name](value) for name, value in row.items()}) for row in csv.DictReader(text.splitlines())
    ]
