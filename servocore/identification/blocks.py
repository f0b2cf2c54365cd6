"""Samples of a log averaged over short blocks, with the noise of each average.

Averages of blocks carry as much information on slow motion as the samples, at a fraction of the cost, and their noise
can be judged: by its quanta where an encoder quantizes, by third differences elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servocore.numerics.compiled_calls import Array

BLOCK = 0.01
"""Shortest block, in s."""

MOVES = 1e-3
"""Range of a position in m or rad below which its drive rests."""

_GAP = 0.3  # s without samples: the motion before and after it is treated apart
_SHORTEST = 1.0  # s of a stretch between gaps
_NEIGHBOURS = 7  # samples in the median with which an outlier is compared
_OUTLIER = 6.0  # standard deviations
_STILL = 1e-5  # noise of a position that never changes, whose quantum is unknown


@dataclass(frozen=True, eq=False)
class Blocks:
    """Averages over blocks of one stretch of a log, shapes (N,) and (N, channels); inputs come first.

    Attributes
    ----------
    t : ndarray
        Mean times in s.
    values : ndarray
        Averages.
    noise : ndarray
        Their standard deviations; infinite where all samples are missing.
    log : int
        Number of the log that the stretch belongs to: its biases and delays are shared.
    """

    t: Array
    values: Array
    noise: Array
    log: int = 0


def stretches(t: Array, values: Array, inputs: int, log: int = 0) -> list[Blocks]:
    """Divide a log at its gaps, and average over blocks.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, increasing.
    values : ndarray, shape (N, channels)
        NaN where a sample is missing.
    inputs : int
        How many channels are inputs.
    log : int
        Number of the log.
    """
    cuts = np.flatnonzero(np.diff(t) > max(_GAP, 5 * float(np.median(np.diff(t))))) + 1
    parts = zip(np.split(t, cuts), np.split(values, cuts), strict=True)
    return [_blocks(time, rows, inputs, log) for time, rows in parts if time[-1] - time[0] >= _SHORTEST]


def _blocks(t: Array, values: Array, inputs: int, log: int) -> Blocks:
    cleaned = np.where(np.column_stack([_outliers(column) for column in values.T]), np.nan, values)
    sizes = [_sample_noise(column) for column in cleaned.T]
    length = max(BLOCK, float(np.median(np.diff(t))))
    _, first = np.unique(np.floor((t - t[0]) / length + 1e-6), return_index=True)
    count = np.diff(np.append(first, len(t)))
    known = np.isfinite(cleaned)
    present = np.add.reduceat(known.astype(float), first)
    filled = np.column_stack([np.interp(t, t[known[:, k]], cleaned[known[:, k], k]) for k in range(values.shape[1])])
    means = np.add.reduceat(filled, first) / count[:, None]
    independent = present.copy()
    for k in range(inputs, values.shape[1]):
        if quantum := _quantum(cleaned[:, k]):
            # Within one quantum all samples have the same error: no more are independent than quanta are passed.
            passed = np.abs(np.gradient(means[:, k])) / quantum
            independent[:, k] = np.minimum(present[:, k], np.maximum(passed, 1.0))
    noise = np.array(sizes) / np.sqrt(np.maximum(independent, 1.0))
    return Blocks(np.add.reduceat(t, first) / count, means, np.where(present > 0, noise, np.inf), log)


def _outliers(x: Array) -> npt.NDArray[np.bool_]:
    """Return which samples are far from the median of their neighbours (Hampel's identifier)."""
    known = np.flatnonzero(np.isfinite(x))
    if len(known) <= _NEIGHBOURS:
        return np.zeros(len(x), dtype=bool)
    padded = np.pad(x[known], _NEIGHBOURS // 2, mode="edge")
    away = np.abs(x[known] - np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS), axis=1))
    usual = 1.4826 * float(np.median(away)) + 2.0 * _quantum(x) + 1e-12 * float(np.abs(x[known]).max())
    found = np.zeros(len(x), dtype=bool)
    found[known] = away > _OUTLIER * max(usual, float(np.sqrt(np.mean(np.sort(away)[: int(0.95 * len(away))] ** 2))))
    return found


def _quantum(x: Array) -> float:
    """Return the step of a quantized signal; 0 for one that is not quantized."""
    steps = np.abs(np.diff(x[np.isfinite(x)]))
    size = float(np.abs(x[np.isfinite(x)]).max(initial=0.0))
    steps = steps[steps > 1e-9 * size]
    if len(steps) < 10:
        return 0.0
    least = float(np.quantile(steps, 0.01))
    off = np.abs(steps / least - np.round(steps / least))
    return least if float(np.quantile(off, 0.9)) < 0.02 else 0.0


def _sample_noise(x: Array) -> float:
    """Return the standard deviation of a sample's noise, by third differences; at least that of a quantum."""
    known = x[np.isfinite(x)]
    rough = float(np.sqrt(np.mean(np.diff(known, 3) ** 2) / 20.0)) if len(known) > 3 else 0.0
    least = 1e-9 * float(np.abs(known).max(initial=0.0)) if np.ptp(known) > 0.0 else _STILL
    return float(max(rough, _quantum(x) / 12.0**0.5, least))
