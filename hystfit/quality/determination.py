"""Which models the data determine: the declared needs of each model against the facts of the data."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping, Sequence

from hystfit.quality.needs import Needs
from hystfit.quality.summary import LONG_HOLD, RecordQuality, distinct

_ASYMMETRIC = 3.0  # percent of the stroke above which a loop is asymmetric
_SYMMETRIC = 1.0  # percent below which terms for asymmetry are not determined


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
        reversals: number of turning points.
        branches_apart: there is an open loop, or no loop could be measured.
        amplitudes: number of different strokes.
        turning_pairs: number of different pairs of neighboring turning levels.
        asymmetry: largest departure from point symmetry [% of the stroke].
        clockwise: most loops run clockwise.
        longest_hold: of the input [samples].
        others: see `RecordQuality`; true where they hold for any record (`timed`: for all).
    """

    reversals: int
    branches_apart: bool
    amplitudes: int
    turning_pairs: int
    asymmetry: float
    clockwise: bool
    longest_hold: int
    timed: bool
    several_frequencies: bool
    degrading: bool
    speed_dependent: bool
    creeps: bool
    drifts_logarithmically: bool
    lags: bool


def _facts(records: Sequence[RecordQuality]) -> _Facts:
    span = max(r.u.high for r in records) - min(r.u.low for r in records)
    shapes = [r.shape for r in records if r.shape is not None]
    circulation = [shape.circulation for shape in shapes if shape.circulation]
    return _Facts(
        reversals=sum(r.motion.reversals for r in records),
        branches_apart=bool(circulation) or not shapes,
        amplitudes=len(distinct(s * r.u.range / span for r in records for s in r.motion.strokes if span > 0)),
        turning_pairs=sum(max(r.motion.turning_pairs, r.motion.reversals > 0) for r in records),
        asymmetry=max((shape.asymmetry_percent for shape in shapes), default=0.0),
        clockwise=circulation.count("clockwise") > len(circulation) / 2,
        longest_hold=max(r.motion.longest_hold for r in records),
        timed=all(r.sampling.rate is not None for r in records),
        several_frequencies=any(r.rate_effect is not None for r in records),
        degrading=any(r.degrading for r in records),
        speed_dependent=any(r.speed_dependent for r in records),
        creeps=any(r.creeps for r in records),
        drifts_logarithmically=any(
            r.drift is not None and r.drift.law == "logarithmic" and r.drift.skipped < 4 for r in records
        ),
        lags=any(r.lags for r in records),
    )


def determine(records: Sequence[RecordQuality], needs: Mapping[str, Needs]) -> tuple[Determination, ...]:
    """Whether these records determine each model, and why.

    Args:
        records: measurements of all records of a data set.
        needs: what each model needs, by its name.
    """
    facts = _facts(records)
    return tuple(Determination(name, *_judge(facts, need)) for name, need in needs.items())


def _judge(facts: _Facts, needs: Needs) -> tuple[Verdict, tuple[str, ...]]:
    excluded = _excluded(facts, needs)
    if excluded:
        return Verdict.NO, tuple(excluded)
    if needs.creep:
        return _judge_creep(facts)
    lacking, remarks = _lacking(facts, needs)
    if facts.speed_dependent:
        lacking.append("the output depends on the input's speed: add a velocity term (viscous or saturating-rate)")
    met = f"{_count(facts.amplitudes, 'amplitude')}, {_count(facts.turning_pairs, 'pair')} of turning levels, " + (
        f"asymmetry {facts.asymmetry:.1f} %"
    )
    return (Verdict.PARTLY if lacking else Verdict.YES), (*(lacking or [met]), *remarks)


def _excluded(facts: _Facts, needs: Needs) -> list[str]:
    """Reasons for which the model cannot describe these data at all."""
    reasons = []
    if needs.loop and facts.reversals == 0:
        return ["the input never turns back: without a loop, hysteresis cannot be distinguished from a curve"]
    if needs.time and not facts.timed:
        reasons.append("no usable time: the parameters in units of time cannot be determined")
    if needs.loop and facts.degrading:
        reasons.append(
            "the loop loses stiffness from cycle to cycle (damage): the model has no terms for degradation or pinching"
        )
    if needs.loop and not facts.branches_apart:
        reasons.append("the branches coincide within the noise: a single-valued curve explains the data")
    return reasons


def _lacking(facts: _Facts, needs: Needs) -> tuple[list[str], list[str]]:
    """Needs that the data do not meet, and remarks that do not change the verdict."""
    lacking, remarks = [], []
    one_amplitude, asymmetric = facts.amplitudes < needs.amplitudes, facts.asymmetry > _ASYMMETRIC
    consequence = f": {needs.too_few}" if needs.too_few else ""
    some, enough = needs.turning_pairs
    if one_amplitude and (needs.symmetry != "generalized" or asymmetric):
        lacking.append(f"only {_count(facts.amplitudes, 'amplitude')}{consequence}")
    if needs.frequencies > 1 and not facts.several_frequencies:
        lacking.append(f"only one frequency{consequence}")
    if facts.turning_pairs < some:
        lacking.append(f"a major loop alone{consequence or ' does not determine the weights'}")
    elif facts.turning_pairs < enough:
        lacking.append(
            f"{_count(facts.turning_pairs, 'pair')} of turning levels: weights of relays that never switch are not determined; "
            "regularize, or measure first-order reversal curves"
        )
    if needs.symmetry == "symmetric" and asymmetric:
        lacking.append(f"the loop is {facts.asymmetry:.1f} % asymmetric, and the model is symmetric")
    if needs.symmetry == "asymmetric" and not one_amplitude and facts.asymmetry < _SYMMETRIC:
        lacking.append(
            f"the loop is symmetric within {max(facts.asymmetry, 0.1):.1f} %: the terms for asymmetry stay near 0"
        )
    if needs.symmetry == "generalized" and asymmetric:
        remarks.append(f"{facts.asymmetry:.1f} % asymmetry: use the generalized form")
    if needs.direction == "counter-clockwise" and facts.clockwise:
        remarks.append("the loop runs clockwise: use stop operators, or allow negative weights")
    return lacking, remarks


def _judge_creep(facts: _Facts) -> tuple[Verdict, tuple[str, ...]]:
    if facts.creeps:
        return Verdict.YES, (f"the output creeps during holds of up to {facts.longest_hold} samples",)
    if facts.drifts_logarithmically:
        return Verdict.YES, ("the mean of like cycles drifts with the logarithm of time",)
    if facts.longest_hold >= LONG_HOLD:
        return Verdict.NO, (f"no creep above the noise during holds of up to {facts.longest_hold} samples",)
    if facts.lags:
        return Verdict.PARTLY, (
            "the output keeps moving after the input has turned: creep or a lag. Compare with and without creep, or measure a "
            "step or hold over several decades of time",
        )
    return Verdict.NO, ("no hold and no logarithmic drift: measure a step or hold over several decades of time",)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
