"""The verdict on a fit: a status, and notes with the numbers on which it rests."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.two_levels import has_two_levels
from hystfit.fitting.judgment.fit_warnings import warnings_of
from hystfit.fitting.judgment.fitted import Fitted
from hystfit.fitting.judgment.record_scales import scale_note
from hystfit.inference.autocorrelation import FEWEST, is_correlated
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import has, warn
from hystfit.params.relative_size import ROUNDED
from hystfit.quality.baselines import MOST_OF, USABLE, VISIBLE, Baselines, curve_scatter, is_resolved
from hystfit.quality.coverage import coverage_notes
from hystfit.quality.damage import whole_until
from hystfit.quality.equal_inputs import apart_note, option_of
from hystfit.quality.faults import FEWEST_SAMPLES, noise_rms, runs
from hystfit.quality.loops import clear_reversals, turns_back
from hystfit.quality.other_curves import no_loop_reason
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import summarize
from hystfit.results.accuracy import (
    NOISY,
    POOR,
    accuracy_note,
    exceeded_limits,
    is_noise,
    is_single_valued_error,
)
from hystfit.results.measured.loop_kinds import may_be_force
from hystfit.results.measured.loop_values import quantities

_LEAST_SHARE = 0.01  # share of hysteresis in the dissipated energy below which its parameters follow the noise
# Part of the shortest time at a level, by which a switch and its model may be apart: a thermostat that is logged 27 times meanwhile, with
# noise of half a step of the temperature, has 0.11.
_MISTIMED = 0.25
_CYCLED = 4  # reversals from which the first half cycle is left out of the largest error


def may_be_noise(rmse: float, baselines: Baselines) -> bool:
    """Whether an error that is visible is as small as neighboring samples show the noise to be, where that is known.

    The few samples of a loop that switches between them leave large residuals that a test for whiteness passes.
    """
    visible = 100 * rmse > VISIBLE * baselines.span
    return not visible or baselines.noise is None or is_noise(rmse, baselines)


def residuals_are_white(rows: Sequence[np.ndarray], plain: float, parameters: float) -> bool:
    """Whether the residuals are white and the loop is significant: no other model can then do better, however large they are.

    `plain` is the RMSE of the best single-valued curve, with which the model is compared by the Bayesian information criterion.
    """
    return are_white(rows) and stands_out(rows, plain, parameters)


def are_white(rows: Sequence[np.ndarray]) -> bool:
    """Whether enough residuals of each record to test them are uncorrelated."""
    return min(row.size for row in rows) >= FEWEST and not any(is_correlated(row) for row in rows)


def stands_out(rows: Sequence[np.ndarray], plain: float, parameters: float) -> bool:
    """Whether the loop is significant for this number of parameters (BIC); arguments as for `residuals_are_white`."""
    count = sum(row.size for row in rows)
    rmse = float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
    return 0 < rmse < plain and bool(2 * count * np.log(plain / rmse) > parameters * np.log(count))


def verdict_of(fitted: Fitted) -> tuple[Status, list[Note]]:
    """Status of a fit, and notes with the reason and the numbers."""
    status, reasons = _status_of(fitted)
    if not fitted.thorough:
        return status, reasons
    notes = [*reasons, accuracy_note(fitted.train, fitted.rows, fitted.baselines, "error"), *warnings_of(fitted)]
    if status is not Status.NO_LOOP and not fitted.model.from_saturation:
        notes += coverage_notes(fitted.data)
    return status, notes


def _error(code: Code, text: str, option: tuple[str, str] | None = None) -> list[Note]:
    return [Note(code, text, Severity.ERROR, option=option)]


def _whole_part(fitted: Fitted) -> tuple[str, str] | None:
    """The option for a window of a single damaged record, before the damage."""
    part, *others = fitted.parts
    if others or len(part) < len(fitted.data[0]) or not _shows_damage(fitted):
        return None
    until = whole_until(part, summarize(part))
    return None if until is None else ("window", f":{until:.10g}")


def _status_of(fitted: Fitted) -> tuple[Status, list[Note]]:
    data, train, baselines, percent = fitted.data, fitted.train, fitted.baselines, fitted.percent
    if not (fitted.model.from_saturation or turns_back(data)):
        return Status.NO_LOOP, [_no_loop(data)]
    reasons = [no_loop_reason(record) for record in data]
    if reasons[0] and all(reasons):
        return Status.NO_LOOP, _error(Code.NO_LOOP, reasons[0])
    parameters = fitted.estimate.x.size
    # Smooth weights may outnumber the samples: the cross-validation that chose their penalty tests them.
    smooth = fitted.model.estimator == "preisach" and fitted.estimate.penalty is not None
    if train.n < FEWEST_SAMPLES or (train.n <= parameters and not smooth):
        text = f"{train.n} samples for {parameters} parameters: too few samples to test the fit"
        return Status.UNDETERMINED, _error(Code.NOT_DETERMINED, text)
    shares = (fitted.model.hysteretic_share(record.u, record.dt) for record in data)
    share = max((share for share in shares if share is not None), default=1.0)
    if percent <= POOR and share < _LEAST_SHARE:
        text = f"hysteresis accounts for only {100 * share:.2g} % of the dissipation: the data show viscous damping, but no hysteresis"
        return Status.NO_LOOP, _error(Code.SINGLE_VALUED, text)
    # If the noise level is unknown or far less, white residuals may also be model errors.
    effective = fitted.estimate.effective or parameters
    noisy = baselines.noise is not None and may_be_noise(train.rmse, baselines)
    white = noisy and residuals_are_white(fitted.rows, baselines.curve, effective)
    if not white and (apart := _records_apart(fitted)) is not None:
        return Status.POOR, [apart]
    unexplained = is_single_valued_error(train.rmse, baselines) and not white
    one_way = fitted.model.from_saturation  # without branches to compare, so that the noise is unknown
    noisy_curve = unexplained and is_noise(min(train.rmse, baselines.curve), baselines)
    single_valued = percent <= POOR and not one_way and (baselines.curve <= ROUNDED * baselines.span or noisy_curve)
    on_one_line = len(data) > 1 and percent <= VISIBLE and unexplained  # one branch alone is always a curve
    if single_valued or (on_one_line if one_way else _branches_coincide(fitted)):
        text = (
            "a single-valued curve describes the data equally well: any hysteresis is below the noise of single samples"
        )
        return Status.NO_LOOP, _error(Code.SINGLE_VALUED, text)
    if fitted.model.jumps and (mistimed := _mistimed(fitted)) is not None:
        return Status.OK, [mistimed]
    poor = None if white else _poor_fit_reason(fitted, unexplained)
    if poor is not None:
        status, reasons = poor
        return status, [*reasons, *([] if has(reasons, Code.MODEL_MISMATCH) else _damaged(fitted))]
    if not fitted.estimate.converged:
        return Status.NOT_CONVERGED, _error(Code.SOLVER, f"{fitted.method}: {fitted.estimate.message}")
    if fitted.model.memoryless and (white or not exceeded_limits(train, _settled_rows(fitted), baselines)):
        text = "a single-valued curve describes these data: they show no hysteresis"
        return Status.NO_LOOP, _error(Code.SINGLE_VALUED, text)
    if white:
        return Status.OK, _noise_notes(fitted)
    rough = [warn(Code.ROUGH_FIT, text) for text in exceeded_limits(train, _settled_rows(fitted), baselines)]
    if rough and not unexplained and train.rmse <= NOISY * (change := _change_by_input_noise(fitted)):
        text = (
            f"the error is {fitted.percent:.3g} % of the range, and noise as large as that of the measured input changes the output of "
            f"the model by {100 * change / baselines.span:.3g} %: measure the input with less noise"
        )
        return Status.OK, [Note(Code.MEASUREMENT_NOISE, text), *_damaged(fitted)]
    status = Status.ROUGH if rough else Status.OK
    visible = percent > VISIBLE and fitted.may_change and not fitted.model.degrades
    return status, [*rough, *_differ(fitted), *(_damaged(fitted) if rough or visible else [])]


def _mistimed(fitted: Fitted) -> Note | None:
    """A note where the output and the model switch as often, and apart by little of the time between: errors of the sampling and noise.

    The rms error counts each of these samples with the whole step, whatever the model of the thresholds.
    """
    latest, wrong, samples = 0, 0, 0
    for record, row in zip(fitted.data, fitted.rows, strict=True):
        y = record.y[record.used]
        if not has_two_levels(y):
            return None
        upper = y > 0.5 * (y.min() + y.max())
        apart = np.abs(row) > 0.5 * np.ptp(y)
        jumps = np.flatnonzero(np.diff(upper)) + 1
        between = np.diff(jumps)
        if between.size < _CYCLED or np.count_nonzero(np.diff(upper ^ apart)) != jumps.size:
            return None
        lengths = np.diff(runs(apart), axis=1)
        latest = max(latest, int(lengths.max(initial=0)))
        if latest > _MISTIMED * between.min():
            return None
        wrong, samples = wrong + int(apart.sum()), samples + y.size
    text = (
        f"the output switches as often as the model, and up to {latest} samples apart: {100 * wrong / samples:.2g} % of the samples are at "
        "the other level meanwhile, as the thresholds are passed between samples or within the noise of the input"
    )
    return Note(Code.MEASUREMENT_NOISE, text) if wrong else None


def _change_by_input_noise(fitted: Fitted) -> float:
    """Rms change of the model's output by another noise of the input, as large as that of the records [y]; 0 where that is unknown."""
    draws, changes = np.random.default_rng(0), []
    for record in fitted.data:
        noise, is_bound = noise_rms(record.u)
        if noise is None or is_bound or not is_resolved(record):
            return 0.0
        other = record.u + noise * draws.standard_normal(record.u.size)
        run = lambda u, dt=record.dt: fitted.model.free_run(u, dt)
        changes.append((run(other) - run(record.u))[record.used])
    return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))


def _settled_rows(fitted: Fitted) -> list[np.ndarray]:
    """Errors of each record after the first half cycle, in which the unknown initial state decays; all errors of a record of few cycles."""
    rows = []
    for row, record in zip(fitted.rows, fitted.data, strict=True):
        turns = clear_reversals(record.u)
        later = np.flatnonzero(record.used) > (turns[0] if turns.size >= _CYCLED else -1)
        rows.append(row[later] if later.any() else row)
    return rows


def _records_apart(fitted: Fitted) -> Note | None:
    """An error note if the model does not describe most of the records, relative to their ranges, or if they differ at equal inputs."""
    if len(fitted.rows) < 2:
        return None
    ranges = [float(np.ptp(record.y[record.used])) for record in fitted.data]
    errors = [
        100 * float(np.sqrt(np.mean(row**2))) / (span or np.inf) for row, span in zip(fitted.rows, ranges, strict=True)
    ]
    missed = [record.name for record, error in zip(fitted.data, errors, strict=True) if error > POOR]
    if fitted.model.from_saturation:
        return None
    apart = apart_note(fitted.parts) if fitted.thorough and fitted.percent > USABLE else None
    if apart is not None:
        return dataclasses.replace(apart, severity=Severity.ERROR)
    if 2 * len(missed) <= len(errors):
        return None
    text = (
        f"the model does not describe {len(missed)} of {len(errors)} records, such as {missed[0]!r} (largest error {max(errors):.3g} % "
        "of the range of the record). If they come from different samples or devices, fit each one separately (only=), or all of them "
        "with hystfit batch"
    )
    return Note(Code.RECORDS_DIFFER, text, Severity.ERROR, option=option_of(missed[0], fitted.data))


def _differ(fitted: Fitted) -> list[Note]:
    """A warning where most of a visible error is that of any one model on records that differ at equal inputs, as at two temperatures."""
    if not fitted.thorough or fitted.percent <= VISIBLE:
        return []
    apart = apart_note(fitted.parts, MOST_OF * fitted.percent) or scale_note(fitted)
    return [] if apart is None else [apart]


def _branches_coincide(fitted: Fitted) -> bool:
    """Whether no loop is open beyond the noise, and the error of the fit is as large as the scatter of the samples about a smooth curve."""
    scatter = curve_scatter(fitted.parts)
    if not fitted.thorough or fitted.train.rmse < MOST_OF * scatter:
        return False
    if fitted.percent > POOR and not is_noise(scatter, fitted.baselines):
        return False
    found = map(summarize, fitted.parts)  # as far as needed: one open loop tells
    return all((quality.shape is None or quality.single_valued) and not quality.dynamic for quality in found)


def _poor_fit_reason(fitted: Fitted, unexplained: bool) -> tuple[Status, list[Note]] | None:
    """Status and reason where the model does not describe the loop.

    Only the usual method, which runs from several starts, shows that the model is unsuitable; another one may not have converged.
    """
    baselines, percent = fitted.baselines, fitted.percent
    code, text = Code.POOR_FIT, ""
    if percent > POOR and (unexplained or not is_noise(fitted.train.rmse, baselines)):
        text = f"the error is {percent:.3g} % of the range: the model does not describe this loop"
    elif percent > USABLE and unexplained:
        share = 100 * fitted.train.rmse / baselines.curve
        text = f"the error is {share:.0f} % of that of a single-valued curve: the model does not describe the loop"
    elif percent > USABLE and not fitted.model.degrades and _shows_damage(fitted):
        code = Code.MODEL_MISMATCH
        text = f"{_damage(fitted)}, and the error is {percent:.3g} % of the range: the model has no term for it (see hystfit check)"
    if not text:
        return None
    if fitted.method != fitted.usual:
        text = f"{text}; {fitted.method} stopped here, and method='{fitted.usual}' may reach a lower error"
        if not fitted.estimate.converged:
            return Status.NOT_CONVERGED, _error(Code.SOLVER, f"{fitted.method}: {fitted.estimate.message}: {text}")
    return Status.POOR, _error(code, text, _whole_part(fitted) if code is Code.MODEL_MISMATCH else None)


def _damaged(fitted: Fitted) -> list[Note]:
    """A warning where the device degrades more than the model does."""
    if not _shows_damage(fitted):
        return []
    lacks = (
        "the damage terms of the model describe only part of it"
        if fitted.model.degrades
        else "the model has no term for it"
    )
    text = f"{_damage(fitted)}: {lacks} (see hystfit check)"
    return [dataclasses.replace(warn(Code.MODEL_MISMATCH, text), option=_whole_part(fitted))]


def _damage(fitted: Fitted) -> str:
    """What a degrading device loses, in words."""
    if any(quality.softens_with_stroke for quality in fitted.qualities):
        return "the loop softens with the largest stroke so far (Mullins effect)"
    if not may_be_force(fitted.data):
        return "the loop shrinks from cycle to cycle (fatigue)"
    return "the loop loses stiffness or strength from cycle to cycle (damage)"


def _shows_damage(fitted: Fitted) -> bool:
    return fitted.thorough and any(quality.degrading for quality in fitted.qualities)


def _noise_notes(fitted: Fitted) -> list[Note]:
    if fitted.percent <= POOR and (
        fitted.percent <= USABLE or not is_single_valued_error(fitted.train.rmse, fitted.baselines)
    ):
        return []
    text = (
        f"the error is {fitted.percent:.3g} % of the range, but the residuals are white (measurement noise): average more cycles or "
        "increase the amplitude"
    )
    return [Note(Code.MEASUREMENT_NOISE, text)]


def _no_loop(data: Dataset) -> Note:
    family = recognize_family(data)
    read = [one.label for values in quantities(data).rows.values() for one in values]
    if family is None and read:
        listed = ", ".join(dict.fromkeys(read))
        text = f"the data are a curve in one direction, without a loop to fit; for {listed}, read directly from the curve, see below"
    elif family is None:
        text = "the input has no reversal of more than 2 % of its range: there is no loop in these data"
    else:
        text = (
            f"{family.words()}; this model starts each of them in equilibrium at its reversal point: use preisach-forc, which starts from "
            "saturation"
        )
    return Note(Code.NO_LOOP, text, Severity.ERROR)
