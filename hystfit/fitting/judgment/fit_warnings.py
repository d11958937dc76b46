"""Warnings of a fit about its records: samples that were left out, a half cycle unlike the others, a delay, a drift, a disturbance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.circulation import of_rate
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.data.two_levels import has_two_levels
from hystfit.fitting.judgment.fitted import Fitted
from hystfit.inference.problem import Problem
from hystfit.models.shared.starting import used_samples
from hystfit.outcome import Code, Note, Severity
from hystfit.outcome.note import warn
from hystfit.quality.baselines import BLOCK, VISIBLE, plays_residuals
from hystfit.quality.check import conditions_of
from hystfit.quality.damage import fails_at
from hystfit.quality.drift import cycle_means
from hystfit.quality.faults import CLEAR, MOST, clipped_samples, saturated_samples
from hystfit.quality.findings import (
    AFTER_FAILURE,
    CONTROLLED,
    chatter_note,
    conducts,
    flat_words,
    is_heat_flow,
    place_of,
    rate_note,
    scale_notes,
)
from hystfit.quality.flat_ends import flat_ends
from hystfit.quality.held_out import correlation_length
from hystfit.quality.load_control import controls_output
from hystfit.quality.loops import APART, SEVERAL, clear_reversals, cycles
from hystfit.quality.record_quality import is_rate
from hystfit.quality.summary import decades_of, delay_of, outliers_of, paces
from hystfit.results.accuracy import better_family_warning, is_noise, persistent_error

BEGINS = 3.0  # times the rms error elsewhere that the largest error exceeds where the first or last half cycle is unlike the others


def warnings_of(fitted: Fitted) -> list[Note]:
    """Warnings of a fit that the status does not carry: another family or pair, an end of the record, samples left out, a delay."""
    # Plays, whose output takes every value, are no other family for one that is switched.
    switches = fitted.model.jumps and all(has_two_levels(record.y[record.used]) for record in fitted.data)
    found = (
        _of_time_alone(fitted),
        None if switches else better_family_warning(fitted.train, fitted.baselines),
        CONTROLLED if any(controls_output(r.u, r.y, clear_reversals(r.u)) for r in fitted.data) else None,
        _failed(fitted),
        _at_an_end(fitted),
        _clipped(fitted.data, fitted.baselines.noise),
        _outliers(fitted.data),
        disturbance_note(fitted.rows, fitted.data, remedy=may_be_robust(fitted.problem)),
        _delayed(fitted),
        _chattering(fitted),
        _at_one_rate(fitted.data),
    )
    scales = scale_notes(*(decades_of(column) for column in used_samples(list(fitted.data))))
    notes = [*conditions_of(fitted.data), *scales, *(note for note in found if note is not None)]
    drift = _drift(fitted)
    return notes if drift is None else [*(n for n in notes if n.code is not Code.INITIAL_STATE), drift]


def _of_time_alone(fitted: Fitted) -> Note | None:
    """A note that the model has no hysteresis, only a lag, a delay or a rate-dependent force."""
    if fitted.model.hysteretic or fitted.model.memoryless:
        return None
    text = "the model has no hysteresis: its loop is due to a lag, a delay or a rate-dependent force, and closes in slow cycles"
    if paces(fitted.data) == 1:
        text = (
            f"{text}; loops of one pace do not tell this from hysteresis: measure at another pace before using it there"
        )
    return Note(Code.SPEED_DEPENDENT, text)


def _drift(fitted: Fitted) -> Note | None:
    """A warning of a drift that the residuals show, or those of plays where a model without time follows it by a state that fades."""
    span = fitted.baselines.span
    found = drift_note(fitted.rows, fitted.data, span)
    if not fitted.thorough or (found is not None and not fitted.model.creeps):
        return found
    if fitted.model.creeps:
        # Slow terms have followed a part of the drift that the residuals of plays have whole.
        known = found is not None and fitted.baselines.plays is not None
        whole = drift_note(plays_residuals(fitted.data), fitted.data, span, _FOLLOWED) if known else None
        return whole or found or _followed_drift(fitted)
    if not fitted.model.rate_independent or fitted.baselines.plays is None:
        return None
    if any(len(one) < 2 or np.any(np.sign(np.diff(one)) != np.sign(one[-1] - one[0])) for one in _means(fitted.data)):
        return None
    return drift_note(plays_residuals(fitted.data), fitted.data, span)


_SUBTRACT = "no model includes a steady drift, so subtract it before the fit"
_FOLLOWED = (
    "slow terms of the model follow it in part or whole: if this is sensor drift, subtract it before the fit; if it is creep, a longer "
    "record determines it better"
)


def _followed_drift(fitted: Fitted) -> Note | None:
    """A warning where the mean of the cycles drifts steadily, and the model follows it: along a line it would err by more than it does."""
    for record, quality in zip(fitted.parts, fitted.qualities, strict=True):
        drift = quality.drift
        if drift is not None and drift.law == "linear" and abs(drift.total) > np.sqrt(12) * fitted.train.rmse:
            size = f"{drift.total:.3g} {record.y_unit}".rstrip()
            return warn(
                Code.DRIFT,
                f"the mean of the cycles of {record.name!r} drifts steadily by {size}: {_FOLLOWED}",
            )
    return None


def _at_one_rate(data: Dataset) -> Note | None:
    """A warning of a rate whose integral makes the loop, and of currents against voltages at one rate, or at an unknown one."""
    heat = is_heat_flow(data.units)
    rates = [r for r in data if (heat or r.t is not None) and is_rate(data.units, of_rate(r.u, r.y))]
    if rates:
        note = rate_note(data.units, certain=True, timed=all(r.t is not None for r in rates))
        return dataclasses.replace(note, severity=Severity.WARNING)
    if not conducts(data.units) or paces(data) > 1:
        return None
    text = (
        "current against voltage at one scan rate: charging and slow reactions open such loops, so the fit is valid at this rate only; "
        "measure at rates a factor of three apart"
    )
    return warn(Code.RATE, text)


def _means(data: Dataset) -> list[np.ndarray]:
    """Mean outputs of the like cycles of each record, in the order of time."""
    return [cycle_means(r.u, r.y, r.t, cycles(r.u, APART * float(np.ptp(r.u))))[0] for r in data]


def _failed(fitted: Fitted) -> Note | None:
    if not fitted.may_change:
        return None
    for record, quality in zip(fitted.parts, fitted.qualities, strict=True):
        if (end := fails_at(record, quality)) is not None:
            text = (
                f"{record.name!r} fails at {place_of(end, quality)}: {AFTER_FAILURE}. The fit includes these strokes, but no model "
                "describes a fracture: fit the part before it (window=)"
            )
            # A window holds for all records, and counts from the first sample.
            alone = len(fitted.data) == 1 and len(record) == len(fitted.data[0])
            return dataclasses.replace(warn(Code.FAILURE, text), option=("window", f":{end:.10g}") if alone else None)
    return None


def _clipped(data: Dataset, noise: float | None) -> Note | None:
    """A warning where samples of a saturated sensor were left out, or fitted samples are at its limit; `noise` is the rms one, if known."""
    saturated = sum(int((saturated_samples(r.u, r.y) & ~r.used).sum()) for r in data)
    if saturated:
        text = (
            f"{saturated} samples of a saturated sensor (the output stays at its limit while the input moves) are left out of the fit: "
            "there, the loop and its quantities come from the model only, and their standard errors do not include model errors"
        )
        return warn(Code.CLIPPED, text)
    count = sum(clipped_samples(record.u[record.used], record.y[record.used]).sum() for record in data)
    if not count:
        level = sum(int(flat_ends(record.u[record.used], record.y[record.used], noise).sum()) for record in data)
        return warn(Code.CLIPPED, flat_words(level)) if level else None
    return warn(
        Code.CLIPPED,
        f"{count} samples of the output stay at its limit while the input moves, and were fitted: if the sensor was saturated, "
        "mark them as missing or fit a window without them (window=)",
    )


def _outliers(data: Dataset) -> Note | None:
    """A warning where isolated outliers were left out, between the first and the last sample that was fitted."""
    count = 0
    for record in data:
        used, found = np.flatnonzero(record.used), outliers_of(record)
        count += int(np.sum(~record.used[found] & (found > used[0]) & (found < used[-1])))
    if not count:
        return None
    which = "1 isolated outlier of the output is" if count == 1 else f"{count} isolated outliers of the output are"
    return warn(Code.SPIKES, f"{which} left out of the fit and of its error; a robust loss (loss='huber') keeps them")


def _delayed(fitted: Fitted) -> Note | None:
    if fitted.percent < VISIBLE or fitted.model.delays or is_noise(fitted.train.rmse, fitted.baselines):
        return None
    found = [(record, delay) for record in fitted.data if (delay := delay_of(record)) is not None]
    if not found:
        return None
    record, delay = found[0]
    clock = f"{delay.seconds:.3g} {record.t_unit}".rstrip()
    return warn(
        Code.DELAY,
        f"the output of {record.name!r} has a pure delay of {delay.samples:.1f} samples ({clock}), which this model does not include: put "
        "delay+ in front of it",
    )


def _chattering(fitted: Fitted) -> Note | None:
    """A warning where noise reverses the input, which a model follows and the device does not."""
    if fitted.percent < VISIBLE or is_noise(fitted.train.rmse, fitted.baselines):
        return None
    # Each run of false steps turns the input twice: turns are counted first, as chatter needs the branches of the record.
    turning = lambda u: 100 * np.count_nonzero(np.diff(np.sign(np.diff(u)))) / u.size
    if not any(turning(record.u) > MOST for record in fitted.parts):
        return None
    motions = [quality.motion for quality in fitted.qualities if quality.motion.chatter_percent > MOST]
    if not motions:
        return None
    worst = max(motions, key=lambda motion: motion.chatter_percent)
    note = chatter_note(worst.chatter_percent, worst.smoothing)
    return dataclasses.replace(note, option=("smooth", str(worst.smoothing))) if worst.smoothing else note


def drift_note(rows: Sequence[np.ndarray], data: Dataset, span: float, advice: str = _SUBTRACT) -> Note | None:
    """A warning where the error of a record has a slope in time, or in the order of its samples, that is no chance.

    Errors, the `rows` of each record [y], count once for the samples over which they are correlated.
    """
    for row, record in zip(rows, data, strict=True):
        if clear_reversals(record.u).size < 2 * SEVERAL - 1:  # else a drift is a loop that does not close
            continue
        t = np.arange(len(record)) if record.t is None else record.t
        passed, missed = t[record.used] - t[record.used].mean(), row.mean() - row
        slope = float(passed @ missed / (passed @ passed))
        change = slope * float(np.ptp(passed))
        if 100 * abs(change) < VISIBLE * span:
            continue
        rest = missed - slope * passed
        error = float(np.sqrt(correlation_length(rest) * np.mean(rest**2) / (passed @ passed)))
        if abs(slope) < CLEAR * error:
            continue
        size = f"{change:.3g} {record.y_unit}".rstrip()
        return warn(
            Code.DRIFT,
            f"the output of {record.name!r} drifts by {size} over the record ({100 * abs(change) / span:.2g} % of the range), apart from "
            f"its loops: {advice}",
        )
    return None


def _at_an_end(fitted: Fitted) -> Note | None:
    """A warning where the largest error lies in the first half cycle (another initial state) or the last one (a device that failed).

    None where a window without it would leave no reversal, and no other half cycle shows whether the model describes this one.
    """
    size = [persistent_error(row) for row in fitted.rows]
    worst = int(np.argmax([row.max() for row in size]))
    record, errors = fitted.data[worst], size[worst]
    largest = 100 * errors.max() / fitted.baselines.span if fitted.baselines.span > 0 else 0.0
    turns = clear_reversals(record.u)
    held = [name for name, _, info in fitted.problem.space.fixed() if info.per_record]
    if turns.size < (1 if held else 2) or largest < VISIBLE:
        return None
    samples = np.flatnonzero(record.used)
    before, after = samples <= turns[0], samples >= turns[-1]
    code, inside = (Code.INITIAL_STATE, before) if before[int(np.argmax(errors))] else (Code.LAST_HALF_CYCLE, after)
    rest = fitted.rows[worst][~inside]
    if not (inside[int(np.argmax(errors))] and rest.size) or errors.max() < BEGINS * float(np.sqrt(np.mean(rest**2))):
        return None
    last = code is Code.LAST_HALF_CYCLE
    if last and _repeats(record, turns, 0.5 * errors.max()):
        return None
    place, number = _place(record, int(turns[-1 if last else 0]))
    which, window = ("last", f":{number}") if last else ("first", f"{number}:")
    remedy = f"the model starts in equilibrium at the first input: fit the record from {place} on (window=)"
    if last:
        remedy = f"if the device failed or was stopped there, fit the record before {place} (window=)"
    elif held:
        remedy = f"the initial state {held[0]} is fixed: free it with free='{held[0]}'"
    text = (
        f"the largest error, {largest:.3g} % of the range, lies in the {which} half cycle of {record.name!r}: {remedy}"
    )
    alone = (last or not held) and len(fitted.data) == 1  # a window holds for all records
    return dataclasses.replace(warn(code, text), option=("window", window) if alone else None)


def _repeats(record: Record, turns: np.ndarray, most: float) -> bool:
    """Whether the last half cycle runs as that of the same direction before it did, within `most` [y]: a device that failed does not."""
    if turns.size < 3:
        return False
    before, after = slice(turns[-3], turns[-2] + 1), slice(turns[-1], len(record))
    order = np.argsort(record.u[before], kind="stable")
    u, y = record.u[before][order], record.y[before][order]
    inside = record.used[after] & (record.u[after] >= u[0]) & (record.u[after] <= u[-1])
    apart = record.y[after][inside] - np.interp(record.u[after][inside], u, y)
    return 2 * inside.sum() > record.used[after].sum() and bool(persistent_error(apart).max() < most)


def _place(record: Record, sample: int) -> tuple[str, str]:
    """The place of a sample in words, and its number in a window: in time, or the sample's where there is none."""
    if record.t is None:
        return f"sample {sample}", str(sample)
    number = f"{record.t[sample]:.9g}"
    return f"{number} {record.t_unit}".rstrip(), number


ROBUST_LOSS = ("loss", "huber")  # option of a fit in which few large errors count less
# Most parameters of such a fit, which descends in all of them: 22 of plays took 7 s, and 496 of a Preisach model 156 s, undetermined.
_ROBUST_MOST = 40


def may_be_robust(problem: Problem) -> bool:
    """Whether a robust loss is a remedy: of a fit without one, of few parameters."""
    return problem.objective.loss == "linear" and len(problem.space) <= _ROBUST_MOST


SHORT = 0.03  # of the samples of a record
# Residuals belong to the stretch that are this many times that rms error, with at most so many samples between two of them.
_OUTSIDE, _GAP = 4.0, 4


def disturbance_note(rows: Sequence[np.ndarray], data: Dataset, *, remedy: bool = True) -> Note | None:
    """A warning of a short stretch of samples, as of a disturbance, with half of the squared error of a record, one of the `rows`.

    A robust loss may be a `remedy`.
    """
    for row, record in zip(rows, data, strict=True):
        if not (row.any() and np.isfinite(row).all()):
            continue
        first, last = shortest_half(row**2)
        if first == 0 or last - first + 1 > SHORT * row.size:
            continue
        others = float(np.sqrt(np.mean(np.delete(row, slice(first, last + 1)) ** 2)))
        ratio = float(np.sqrt(np.mean(row[first : last + 1] ** 2))) / max(others, 1e-300)  # at least sqrt(0.97 / 0.03)
        far = np.flatnonzero(np.abs(row) > _OUTSIDE * others)
        stretch = next(part for part in np.split(far, np.flatnonzero(np.diff(far) > _GAP) + 1) if part[-1] >= first)
        # Counted from the first measured sample, which a cycle before the record may precede.
        number = np.flatnonzero(record.used)[[min(first, stretch[0]), max(last, stretch[-1])]] - record.first
        place = f"sample {number[0]}" if number[0] == number[1] else f"samples {number[0]} to {number[1]}"
        remedies = "mark them as missing" + ", or use a robust loss (loss='huber')" * remedy
        note = warn(
            Code.SPIKES,
            f"most of the squared error of {record.name!r} lies in {place} of {len(record) - record.first}, where the error "
            f"is {ratio:.2g} times as large as elsewhere: if the sensor was disturbed there, {remedies}",
        )
        return dataclasses.replace(note, option=ROBUST_LOSS) if remedy else note
    return None


def shortest_half(squares: np.ndarray) -> tuple[int, int]:
    """First and last of the fewest samples in a row that carry half of a sum of squares, shape (n,)."""
    count, total = squares.size, np.zeros(squares.size + 1)
    np.cumsum(squares, out=total[1:])
    first, fewest = 0, count + 1
    for begin in range(0, count, BLOCK):
        starts = np.arange(begin, min(begin + BLOCK, count))
        stops = np.searchsorted(total, total[starts] + 0.5 * total[-1])
        length = np.where(stops <= count, stops - starts, count)
        if length.min() < fewest:
            first, fewest = begin + int(np.argmin(length)), int(length.min())
    return first, first + fewest - 1
