"""Two figures: what effects cost, for docs/model-levels.md, and estimates beside simulations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.atlas.style import FOURTH, GOOD, OTHER, STYLE
from benchmarks.effects.cases import DURATIONS
from benchmarks.effects.measure import LINES, Pair
from servocore.effects.report import ESTIMATED, SIMULATED

_MARKS = dict(zip(DURATIONS, ((GOOD, "o"), (OTHER, "^"), ("#000000", "s")), strict=True))
_SHOWN = ("rotary crane", "big rotary crane")


def draw_levels(pairs: Sequence[Pair], target: Path) -> None:
    """Draw the error of leaving out each effect, for two cranes and three durations."""
    shown = [each for each in pairs if each.crane in _SHOWN]
    worst = {each.effect: 0.0 for each in shown}
    for each in shown:
        worst[each.effect] = max(worst[each.effect], each.simulated)
    effects = sorted(worst, key=lambda name: worst[name])
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(7.4, 3.4), sharey=True, sharex=True, layout="constrained")
        for axis, crane in zip(axes, _SHOWN, strict=True):
            _levels_of(axis, [each for each in shown if each.crane == crane], effects)
            axis.set_title(crane)
            axis.set_xlabel("tracking error if neglected (mm)")
        axes[1].legend(title="duration", loc="lower right")
        figure.savefig(target)
        plt.close(figure)


def _levels_of(axis: Axes, pairs: Sequence[Pair], effects: Sequence[str]) -> None:
    for line in LINES:
        axis.axvline(line, color="#888888", lw=1.0, ls="--", zorder=0)
    for name in effects:
        own = [each.simulated for each in pairs if each.effect == name]
        axis.plot([min(own), max(own)], [effects.index(name)] * 2, color="#bbbbbb", lw=2.0, zorder=1)
    for k, (duration, (colour, mark)) in enumerate(_MARKS.items()):
        own_pairs = [each for each in pairs if each.duration == duration]
        errors = [each.simulated for each in own_pairs]
        places = [effects.index(each.effect) + 0.17 * (1 - k) for each in own_pairs]
        axis.plot(errors, places, ls="", marker=mark, color=colour, label=f"{duration:g} s")
    axis.set_xscale("log")
    axis.set_xlim(0.05, 1000.0)
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_yticks(range(len(effects)), effects)


def draw_comparison(pairs: Sequence[Pair], target: Path) -> None:
    """Draw estimated against simulated errors, and their ratio; filled where `effects` shows the simulation."""
    looks = {"rotary crane": (GOOD, "o"), "big rotary crane": ("#000000", "s"), "gantry crane": (OTHER, "^"),
             "overhead crane": (FOURTH, "D")}  # fmt: skip
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(7.4, 3.4), sharex=True, layout="constrained")
        for crane, (colour, mark) in looks.items():
            for how in (ESTIMATED, SIMULATED):
                own = [each for each in pairs if each.crane.rstrip(" 0123456789") == crane and each.how == how]
                x, fill = [each.simulated for each in own], "none" if how == ESTIMATED else colour
                line = {"ls": "", "marker": mark, "color": colour, "mfc": fill}
                left.plot(x, [each.estimated for each in own], label=crane if how == ESTIMATED else None, **line)
                right.plot(x, [each.ratio for each in own], **line)
        span = [0.01, 1500.0]
        left.plot(span, span, color="#888888", lw=0.8, zorder=0)
        for line_ in LINES:
            left.axhline(line_, color="#888888", lw=0.8, ls="--", zorder=0)
            for axis in (left, right):
                axis.axvline(line_, color="#888888", lw=0.8, ls="--", zorder=0)
        right.axhspan(0.9, 1.1, color="#dddddd", zorder=0)
        left.set(xscale="log", yscale="log", xlim=span, ylim=span, xlabel="simulated (mm)", ylabel="estimated (mm)")
        right.set(xlabel="simulated (mm)", ylabel="estimated / simulated", ylim=(0.75, 1.25))
        left.legend(loc="upper left")
        figure.savefig(target)
        plt.close(figure)
