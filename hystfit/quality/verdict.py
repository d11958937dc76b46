"""What each model can and cannot learn from the data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hystfit.quality.quality import Determination, RecordQuality

MODELS = (
    "duhem",
    "bouc-wen",
    "bouc-wen-asymmetric",
    "bouc-wen-oscillator",
    "preisach",
    "prandtl-ishlinskii",
    "creep",
)


def degrades(record: RecordQuality) -> bool:
    """Stiffness is lost from cycle to cycle, beyond what a loop without damage shows."""
    if record.shape is None:
        return False
    left, pinching = record.stiffness_left, record.shape.pinching
    return left is not None and (left < 0.88 or (left < 0.95 and pinching < 0.6))


def depends_on_speed(record: RecordQuality) -> bool:
    """The output turns ahead of the input and velocity terms explain most of what is left, or the area changes."""
    ahead = record.lag is not None and record.lag.samples < -2 * record.lag.stderr
    explained = record.velocity_gain is not None and record.velocity_gain > 0.5
    return (ahead and explained) or (record.rate_effect is not None and abs(record.rate_effect) > 0.1)


@dataclasses.dataclass(frozen=True)
class Facts:
    """What the models ask of a whole data set; strokes are fractions of the input range over all records."""

    turns: int
    open: bool
    strokes: tuple[float, ...]
    pairs: int
    timed: bool
    damaged: bool
    fast: bool
    asymmetry: float
    clockwise: bool
    rest: int
    crept: bool
    log_drift: bool
    late: bool
    spread: float | None


def gather(records: Sequence[RecordQuality]) -> Facts:
    """Facts of a data set from the measurements of its records."""
    span = max(r.u.high for r in records) - min(r.u.low for r in records)
    strokes = sorted((s * r.u.range / span for r in records for s in r.motion.strokes if span > 0), reverse=True)
    kept: list[float] = []
    for stroke in strokes:
        if not kept or kept[-1] - stroke > 0.05:
            kept.append(stroke)
    shapes = [r.shape for r in records if r.shape is not None]
    circulation = [s.circulation for s in shapes if s.circulation]
    spreads = [r.rate_effect for r in records if r.rate_effect is not None]
    return Facts(
        turns=sum(r.motion.reversals for r in records),
        open=bool(circulation) or not shapes,
        strokes=tuple(kept),
        pairs=sum(max(r.motion.turning_pairs, r.motion.reversals > 0) for r in records),
        timed=all(r.sampling.rate is not None for r in records),
        damaged=any(degrades(r) for r in records),
        fast=any(depends_on_speed(r) for r in records),
        asymmetry=max((s.asymmetry_percent for s in shapes), default=0.0),
        clockwise=circulation.count("clockwise") > len(circulation) / 2,
        rest=max(r.motion.longest_hold for r in records),
        crept=any(_crept(r) for r in records),
        log_drift=any(r.drift is not None and r.drift.law == "logarithmic" and r.drift.skipped < 4 for r in records),
        late=any(moves_on(r) for r in records),
        spread=spreads[0] if spreads else None,
    )


def moves_on(record: RecordQuality) -> bool:
    """The output keeps moving after the input has turned."""
    return record.lag is not None and record.lag.samples > 2 * record.lag.stderr


def _crept(record: RecordQuality) -> bool:
    """The output moved during a rest of 50 samples or more by more than noise explains."""
    motion, noise = record.motion, record.y.noise_rms or 0.0
    if motion.longest_hold < 50 or motion.hold_creep is None or record.sampling.rate is None:
        return False
    return motion.hold_creep * record.y.range > 4 * noise / (motion.longest_hold / 20) ** 0.5


NO_LOOP = "the input never turns back: there is no loop, and nothing tells hysteresis from a single-valued curve"
CLOSED = "the two branches lie on each other within what is measured: a single-valued curve explains the data"
DAMAGE = (
    "the loop loses stiffness from cycle to cycle (damage), which the model cannot make: it needs terms for "
    "degradation and pinching"
)
ONE_SIZE = "one amplitude only"


def determine(records: Sequence[RecordQuality]) -> tuple[Determination, ...]:
    """What each of the models of `MODELS` can learn from these records."""
    from hystfit.quality.quality import Determination

    facts = gather(records)
    judges: dict[str, Callable[[Facts], tuple[str, list[str]]]] = {
        "duhem": _duhem,
        "bouc-wen": _bouc_wen,
        "bouc-wen-asymmetric": _asymmetric,
        "bouc-wen-oscillator": _oscillator,
        "preisach": _preisach,
        "prandtl-ishlinskii": _plays,
        "creep": _creep,
    }
    found = []
    for model in MODELS:
        verdict, reasons = ("no", [NO_LOOP]) if facts.turns == 0 and model != "creep" else judges[model](facts)
        if facts.fast and verdict != "no" and model != "creep":
            verdict = "partly"
            reasons.append("the output depends on the input's speed: add a velocity (viscous or saturating) term")
        found.append(Determination(model, verdict, tuple(reasons)))
    return tuple(found)


def _unsuited(facts: Facts) -> list[str]:
    """Reasons that rule out every model of an undamaged loop."""
    return ([DAMAGE] if facts.damaged else []) + ([] if facts.open else [CLOSED])


def _duhem(facts: Facts) -> tuple[str, list[str]]:
    if reasons := _unsuited(facts):
        return "no", reasons
    if len(facts.strokes) < 2:
        return "partly", [f"{ONE_SIZE}: f and g are seen along one pair of branches, and trade off within it"]
    return "yes", [
        f"{len(facts.strokes)} amplitudes pin f, g and alpha; the model forgets locally, so nested minor loops may "
        "not close as measured ones do"
    ]


def _bouc_wen(facts: Facts) -> tuple[str, list[str]]:
    if reasons := _unsuited(facts):
        return "no", reasons
    reasons = []
    if len(facts.strokes) < 2:
        reasons.append(f"{ONE_SIZE}: the classic parameters (A, beta, gamma, n) are nearly redundant; fix A = 1")
    if facts.asymmetry > 3:
        reasons.append(f"the loop is {facts.asymmetry:.1f} % asymmetric and this model's is symmetric")
    return ("partly", reasons) if reasons else ("yes", [f"{len(facts.strokes)} amplitudes and a symmetric loop"])


def _asymmetric(facts: Facts) -> tuple[str, list[str]]:
    if reasons := _unsuited(facts):
        return "no", reasons
    if len(facts.strokes) < 2:
        return "partly", [f"{ONE_SIZE}: the shape parameters are nearly redundant"]
    if facts.asymmetry < 1:
        return "partly", [
            f"the loop is symmetric within {max(facts.asymmetry, 0.1):.1f} %: the terms for asymmetry stay near 0"
        ]
    return "yes", [f"{len(facts.strokes)} amplitudes and {facts.asymmetry:.1f} % asymmetry to learn from"]


def _oscillator(facts: Facts) -> tuple[str, list[str]]:
    if not facts.timed:
        return "no", ["no usable time: mass and damping cannot be determined"]
    if reasons := _unsuited(facts):
        return "no", reasons
    if facts.spread is None:
        return "partly", ["one frequency only: mass, damping and stiffness trade off; it needs several, or a resonance"]
    return "yes", ["several frequencies; the input must be a force and the output a displacement"]


def _preisach(facts: Facts) -> tuple[str, list[str]]:
    if reasons := _unsuited(facts):
        return "no", reasons
    if facts.pairs < 3:
        return "partly", [
            "a major loop alone does not identify a Preisach density: it gives about 2 n numbers for the "
            "n (n + 1) / 2 weights of n levels; smooth or regularize, and do not trust minor loops"
        ]
    if facts.pairs < 10:
        return "partly", [
            f"{facts.pairs} pairs of turning levels: relays that they do not switch stay undetermined; regularize, or "
            "measure first-order reversal curves"
        ]
    return "yes", [f"{facts.pairs} different pairs of turning levels cover the triangle of thresholds"]


def _plays(facts: Facts) -> tuple[str, list[str]]:
    if reasons := _unsuited(facts):
        return "no", reasons
    reasons = []
    if facts.clockwise:
        reasons.append("the loop runs clockwise: weights of the plays must be free to be negative (or use stops)")
    if facts.asymmetry > 3:
        reasons.append(f"{facts.asymmetry:.1f} % asymmetry: the generalized form (envelopes or dead zones) is needed")
    reasons.append(f"thresholds up to half of the largest stroke are determined, {len(facts.strokes)} stroke(s) seen")
    return ("partly" if len(facts.strokes) < 2 and facts.asymmetry > 3 else "yes"), reasons


def _creep(facts: Facts) -> tuple[str, list[str]]:
    if not facts.timed:
        return "no", ["no usable time: creep is a law of time"]
    if facts.crept:
        return "yes", [f"the output creeps while the input rests, for up to {facts.rest} samples"]
    if facts.log_drift:
        return "yes", ["the mean of like cycles drifts with the logarithm of time"]
    if facts.rest >= 50:
        return "no", [f"the input rests for up to {facts.rest} samples, and no creep shows above the noise"]
    if facts.late:
        return "partly", [
            "the output keeps moving after the input turned, which may be creep or a lag: see whether +log-creep pays "
            "in a comparison; a step or a hold of several decades tells them apart"
        ]
    return "no", ["no rest of the input and no logarithmic drift: a step or a hold of several decades is needed"]
