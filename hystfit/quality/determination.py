"""Which models the data determine: the declared needs of each model against the facts of the data."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence

from hystfit.outcome.note import Code, Note, Severity
from hystfit.quality.baselines import USABLE, VISIBLE
from hystfit.quality.faults import FEWEST_SAMPLES
from hystfit.quality.loops import SEVERAL, SPEEDS_APART, distinct
from hystfit.quality.needs import Needs
from hystfit.quality.record_quality import LONG_HOLD, RecordQuality

_SAMPLES_PER_PARAMETER = 3  # below which a fit follows its noise
_FEW_RECORDS = 0.1  # part of the records in which a drift may be chance
_MIRROR = ", unless negate in front reverses the sign of the input"
_FEW_PER_BRANCH = 6  # samples below which branches have a coarse shape; below `SEVERAL` they have none


class Verdict(enum.StrEnum):
    """Whether data determine the parameters of a model."""

    YES = "yes"
    PARTLY = "partly"
    NO = "no"


@dataclasses.dataclass(frozen=True)
class Determination:
    """Whether the data determine a model, and why."""

    model: str
    verdict: Verdict
    reasons: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class _Facts:
    """What a data set offers to a model.

    Attributes:
        samples: number that count.
        per_branch: mean number of them between reversals.
        reversals: number of turning points.
        crossing: the branches cross in every loop.
        branches_apart: there is an open loop, or no loop could be measured.
        amplitudes: number of different strokes.
        turning_pairs: number of different pairs of neighboring turning levels.
        speeds: number of different speeds of the input.
        asymmetry: largest departure from point symmetry [% of the stroke].
        clockwise, counter_clockwise: most loops run in this direction, mirrored where the output falls.
        falls: the output falls as the input rises, in most records.
        longest_hold: of the input [samples].
        others: see `RecordQuality`; true where they hold for any record (`timed`: for all).
    """

    samples: int
    per_branch: float
    reversals: int
    crossing: bool
    branches_apart: bool
    amplitudes: int
    turning_pairs: int
    speeds: int
    asymmetry: float
    clockwise: bool
    counter_clockwise: bool
    falls: bool
    longest_hold: int
    timed: bool
    dynamic: bool
    degrading: bool
    is_rate: bool
    speed_dependent: bool
    creeps: bool
    drifts_logarithmically: bool
    lags: bool

    @property
    def too_few(self) -> bool:
        """Whether there are too few samples for any model."""
        return self.samples < FEWEST_SAMPLES or self.per_branch < SEVERAL


def few_samples(records: Sequence[RecordQuality]) -> Note | None:
    """The objection to records with too few samples, or too few between reversals; None where there are enough."""
    facts = _facts(records)
    if not facts.too_few and facts.per_branch >= _FEW_PER_BRANCH:
        return None
    text = f"{_few_words(facts)}: sample more often, or drive the input more slowly"
    return Note(Code.TOO_FEW_SAMPLES, text, Severity.ERROR if facts.too_few else Severity.WARNING)


def _few_words(facts: _Facts) -> str:
    size = f"{count(facts.samples, 'sample')}, {facts.per_branch:.3g} between reversals on average"
    if facts.too_few:
        return f"{size}: too few for any model of hysteresis"
    return f"{size}: turning points and the shape of branches are coarse (at least {_FEW_PER_BRANCH} are needed)"


def _facts(records: Sequence[RecordQuality]) -> _Facts:
    span = max(r.u.high for r in records) - min(r.u.low for r in records)
    shapes = [r.shape for r in records if r.shape is not None]
    circulation = [way for r in records if (way := r.circulation)]
    dynamic = any(r.dynamic for r in records)
    most = lambda direction: not dynamic and circulation.count(direction) > len(circulation) / 2
    samples = sum(r.sampling.used for r in records)
    return _Facts(
        samples=samples,
        per_branch=samples / sum(r.motion.reversals + 1 for r in records),
        reversals=sum(r.motion.reversals for r in records),
        crossing=bool(shapes) and all(shape.crossing for shape in shapes),
        branches_apart=bool(circulation) or not shapes or any(r.degrading for r in records),
        amplitudes=len(distinct(s * r.u.range / span for r in records for s in r.motion.strokes if span > 0)),
        turning_pairs=sum(max(r.motion.turning_pairs, r.motion.reversals > 0) for r in records),
        speeds=len(distinct((s for r in records for s in r.motion.speeds), SPEEDS_APART)),
        asymmetry=max((shape.asymmetry_percent for shape in shapes), default=0.0),
        clockwise=most("clockwise"),
        counter_clockwise=most("counter-clockwise"),
        falls=2 * sum(r.falls for r in records) > len(records),
        longest_hold=max(r.motion.longest_hold for r in records),
        timed=all(r.sampling.rate is not None for r in records),
        dynamic=dynamic,
        is_rate=any(r.is_rate for r in records),
        degrading=any(r.degrading for r in records),
        speed_dependent=any(r.speed_dependent for r in records),
        creeps=any(r.creeps for r in records),
        drifts_logarithmically=_drift_logarithmically(records),
        lags=any(r.lags for r in records),
    )


def _drift_logarithmically(records: Sequence[RecordQuality]) -> bool:
    """Whether drift is logarithmic in most records in which it is measured, and these are not a few of many by chance."""
    drifts = [r.drift for r in records if r.drift is not None]
    logarithmic = sum(one.law == "logarithmic" for one in drifts)
    return 2 * logarithmic > len(drifts) and logarithmic >= _FEW_RECORDS * len(records)


def determine(records: Sequence[RecordQuality], needs: Mapping[str, Needs]) -> tuple[Determination, ...]:
    """Whether these records determine each model, and why."""
    facts = _facts(records)
    return tuple(Determination(name, *_judge(facts, need)) for name, need in needs.items())


def _judge(facts: _Facts, needs: Needs) -> tuple[Verdict, tuple[str, ...]]:
    excluded = _excluded(facts, needs)
    if excluded:
        return Verdict.NO, tuple(excluded)
    if needs.creep:
        return _judge_creep(facts)
    lacking, remarks = _lacking(facts, needs)
    if facts.speed_dependent and not needs.rate:
        lacking.append("the output depends on the input's speed: add a velocity term (viscous or saturating-rate)")
    if facts.dynamic and not needs.dynamics:
        lacking.append("the output resonates: add second-order")
    met = f"{count(facts.amplitudes, 'amplitude')}, {count(facts.turning_pairs, 'pair')} of turning levels, " + (
        f"asymmetry {facts.asymmetry:.1f} %"
    )
    return (Verdict.PARTLY if lacking else Verdict.YES), (*(lacking or [met]), *remarks)


def _excluded(facts: _Facts, needs: Needs) -> list[str]:
    """Reasons for which the model cannot describe these data at all."""
    reasons = []
    if facts.too_few:
        return [_few_words(facts)]
    if needs.loop and facts.reversals == 0:
        return ["the input never reverses: without a loop, hysteresis cannot be distinguished from a curve"]
    if needs.rate and facts.reversals == 0 and facts.longest_hold < LONG_HOLD:
        return ["the input neither reverses nor rests: rate dependence cannot be distinguished from a curve"]
    if needs.time and not facts.timed:
        reasons.append("no usable time: the parameters in units of time cannot be determined")
    if needs.loop and facts.is_rate:
        reasons.append("the output is the rate of what makes the loop: the model describes its integral over time")
    if needs.loop and facts.degrading and not needs.damage:
        reasons.append(
            "the loop loses stiffness or strength (damage or backlash): the model has no terms for degradation or pinching"
        )
    if needs.loop and facts.crossing:
        reasons.append("the branches cross: the model describes loops that circulate in one direction")
    elif needs.loop and not facts.branches_apart:
        reasons.append("the branches coincide within the noise: a single-valued curve explains the data")
    mirrored = "mirrored " if facts.falls else ""
    if facts.clockwise and needs.direction == "counter-clockwise":
        reasons.append(
            f"the {mirrored}loop runs clockwise (the output leads), and the model describes loops that lag{_MIRROR}"
        )
    if facts.counter_clockwise and needs.direction == "clockwise":
        reasons.append(
            f"the {mirrored}loop runs counter-clockwise (the output lags), and the model describes loops that lead{_MIRROR}"
        )
    if facts.samples <= needs.parameters and not needs.regularized:
        reasons.append(_outnumbered(facts, needs))
    return reasons


def _outnumbered(facts: _Facts, needs: Needs) -> str:
    return f"{count(facts.samples, 'sample')} for {count(needs.parameters, 'parameter')}"


def _lacking(facts: _Facts, needs: Needs) -> tuple[list[str], list[str]]:
    """Needs that the data do not meet, and remarks that do not change the verdict."""
    lacking, remarks = [], []
    # The asymmetry is the least rms error of a symmetric model.
    one_amplitude, asymmetric = facts.amplitudes < needs.amplitudes, facts.asymmetry > USABLE
    consequence = f": {needs.too_few}" if needs.too_few else ""
    some, enough = needs.turning_pairs
    if one_amplitude and (needs.symmetry != "generalized" or asymmetric):
        lacking.append(f"only {count(facts.amplitudes, 'amplitude')}{consequence}")
    if facts.timed and facts.speeds < needs.speeds:
        lacking.append(f"{count(facts.speeds, 'speed')} of the input, {needs.speeds} are needed{consequence}")
    if needs.dynamics and not facts.dynamic:
        lacking.append(f"no response that changes with frequency{consequence}")
    if facts.samples <= needs.parameters:
        lacking.append(f"{_outnumbered(facts, needs)}: the smoothing penalty decides between the weights")
    elif facts.samples < _SAMPLES_PER_PARAMETER * needs.parameters and not needs.regularized:
        lacking.append(f"{_outnumbered(facts, needs)}, at least {_SAMPLES_PER_PARAMETER} for each are needed")
    if facts.per_branch < _FEW_PER_BRANCH:
        lacking.append(f"{facts.per_branch:.3g} samples between reversals")
    if facts.turning_pairs < some:
        lacking.append(f"a major loop alone{consequence or ' does not determine the weights'}")
    elif facts.turning_pairs < enough:
        lacking.append(
            f"{count(facts.turning_pairs, 'pair')} of turning levels: weights of relays that never switch are not determined; "
            "regularize, or measure first-order reversal curves"
        )
    if needs.symmetry == "symmetric" and asymmetric:
        lacking.append(f"the loop is {facts.asymmetry:.1f} % asymmetric, and the model is symmetric")
    if needs.symmetry == "asymmetric" and not one_amplitude and facts.asymmetry < VISIBLE:
        lacking.append(
            f"the loop is symmetric within {max(facts.asymmetry, 0.1):.1f} %: the terms for asymmetry stay near 0"
        )
    if needs.symmetry == "generalized" and one_amplitude and not asymmetric:
        remarks.append("loops of other amplitudes follow from the model alone")
    if needs.symmetry == "generalized" and asymmetric:
        remarks.append(f"{facts.asymmetry:.1f} % asymmetry: use the generalized form")
    return lacking, remarks


def _judge_creep(facts: _Facts) -> tuple[Verdict, tuple[str, ...]]:
    if facts.dynamic:
        return Verdict.NO, ("the output resonates: creep cannot be distinguished from its response",)
    if facts.clockwise:
        return Verdict.NO, ("the loop runs clockwise: a force relaxes during holds, which creep does not describe",)
    if facts.creeps:
        return Verdict.YES, (f"the output creeps during holds of up to {facts.longest_hold} samples",)
    if facts.drifts_logarithmically:
        return Verdict.YES, ("the mean of similar cycles drifts with the logarithm of time",)
    if facts.longest_hold >= LONG_HOLD:
        return Verdict.NO, (f"no creep above the noise during holds of up to {facts.longest_hold} samples",)
    if facts.lags:
        return Verdict.PARTLY, (
            "the output keeps moving after the input has reversed: creep or a lag. Compare with and without creep, or measure a "
            "step or hold over several decades of time",
        )
    return Verdict.NO, ("no hold and no logarithmic drift: measure a step or hold over several decades of time",)


def count(number: int, noun: str) -> str:
    """A number with its noun."""
    return f"{number} {noun}" + ("" if number == 1 else "s")
