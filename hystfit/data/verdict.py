"""The verdict in words: findings on the data, and what each model can and cannot learn from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hystfit.data.quality import Determination, QualityReport, RecordQuality

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
        late=any(_moves_on(r) for r in records),
        spread=spreads[0] if spreads else None,
    )


def _moves_on(record: RecordQuality) -> bool:
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
    from hystfit.data.quality import Determination

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


def findings(records: Sequence[RecordQuality]) -> tuple[str, ...]:
    """What is wrong or worth knowing, one sentence each, with the record's name where there are several."""
    told = []
    for record in records:
        prefix = f"{record.name}: " if len(records) > 1 else ""
        told += [prefix + line for line in (*_faults(record), *_traits(record))]
    return tuple(told)


def _faults(record: RecordQuality) -> list[str]:
    told, sampling, unit = [], record.sampling, record.units["y"]
    if sampling.rate is None:
        told.append(
            "no usable time: rate-dependent terms, lag and creep cannot be determined, rate-independent models can"
        )
    elif not sampling.uniform:
        told.append("time steps are uneven: lag is not estimated")
    if sampling.repeated_stamps:
        told.append(f"{sampling.repeated_stamps} repeated time stamps")
    if sampling.gaps:
        told.append(f"{sampling.gaps} gaps in time (more than 1.5 steps)")
    if sampling.missing:
        told.append(f"{sampling.missing} missing outputs ({100 * sampling.missing / sampling.n:.1f} %)")
    if record.clipped:
        told.append(f"{record.clipped} samples of the output stand at its end while the input moves: clipped?")
    if record.spikes:
        told.append(f"{record.spikes} spikes in the output: use a robust loss")
    if record.motion.chatter_percent > 5:
        told.append(
            f"the input chatters ({record.motion.chatter_percent:.0f} % of its steps go back): smooth it, or a model "
            "sees loops that are noise"
        )
    noise, span = record.y.noise_rms, record.y.range
    if noise and not record.y.noise_is_bound and span > 0 and noise > 0.02 * span:
        told.append(
            f"output noise is {noise:.3g} {unit} rms, {100 * noise / span:.1f} % of its range".replace("  ", " ")
        )
    return told


def _traits(record: RecordQuality) -> list[str]:
    told, shape, drift, lag = [], record.shape, record.drift, record.lag
    unit, clock = record.units["y"], record.units["t"]
    if record.motion.monotonic:
        told.append("monotonic: the input never turns back, so there is no loop")
    if shape is not None and shape.circulation is None:
        told.append("the branches lie on each other: no hysteresis within what is measured")
    if shape is not None and shape.closure_percent is not None and abs(shape.closure_percent) > 2:
        told.append(f"the last large loop does not close: {shape.closure_percent:+.1f} % of its stroke")
    if degrades(record) and shape is not None:
        pinched = shape.pinching < 0.6
        thin = f", and pinched to {100 * shape.pinching:.0f} % of its width in the middle" if pinched else ""
        told.append(
            f"degrading: late loops keep {100 * (record.stiffness_left or 0.0):.0f} % of the first stiffness at the "
            f"same stroke{thin} (damage); a plain Bouc-Wen, Duhem, play or Preisach model cannot make this loop"
        )
    if drift is not None and drift.law != "none":
        size = f"{drift.per_decade:.3g} {unit}/decade, R2 {drift.r2_log:.3f}"
        if drift.law == "linear":
            size = f"{drift.per_cycle:.3g} {unit}/cycle, R2 {drift.r2_linear:.3f}"
        told.append(f"the mean drifts ({drift.law}, {size})")
        if shape is not None and abs(drift.total) > 0.3 * shape.width:
            told.append("the drift is comparable to the width of the loop: model it, or remove it with care")
    if lag is not None and _moves_on(record):
        told.append(
            f"the output keeps moving for {lag.samples:.1f} +- {lag.stderr:.1f} samples ({lag.seconds:.3g} {clock}) "
            "after the input turned: a delay, a fast lag or creep, not hysteresis"
        )
    if depends_on_speed(record):
        ahead = lag is not None and lag.samples < -2 * lag.stderr
        why = (
            f"it turns {-lag.samples:.1f} samples ahead of the input" if ahead and lag else "the area changes with rate"
        )
        told.append(f"the output depends on the input's speed ({why}): it needs a velocity term")
    return told


def page(report: QualityReport) -> str:
    """The report as text."""
    lines = [f"Data quality: {report.name}"]
    for record in report.records if len(report.records) <= 8 else report.records[:4]:
        lines += ["", *_block(record)]
    if len(report.records) > 8:
        lines.append(f"  ... and {len(report.records) - 4} more records")
    lines += ["", "Findings"]
    lines += [f"  - {line}" for line in report.findings[:40]] or ["  - nothing to object to"]
    if len(report.findings) > 40:
        lines.append(f"  ... and {len(report.findings) - 40} more")
    lines += ["", "What these data determine"]
    for item in report.determines:
        lines += [f"  {item.model:<20} {item.verdict:<7} {'; '.join(item.reasons)}"]
    return "\n".join(lines)


DRIFTLESS = "unknown: it takes four cycles between like turning levels"


def _block(record: RecordQuality) -> list[str]:
    sampling, motion, shape, units = record.sampling, record.motion, record.shape, record.units
    rate = "no time"
    if sampling.rate is not None:
        rate = f"{sampling.rate:.6g} per {units['t'] or 'unit of time'}, {sampling.duration:.6g} {units['t']} long"
    rows = [("samples", f"{sampling.n}, {rate}")]
    for symbol, column in (("input u", record.u), ("output y", record.y)):
        unit = units[symbol[-1]]
        noise = "unknown" if column.noise_rms is None else f"{column.noise_rms:.2g}"
        noise = ("at most " if column.noise_is_bound else "") + noise
        rows.append((symbol, f"{column.low:.6g} .. {column.high:.6g} {unit}, noise {noise} rms".replace("  ", " ")))
    rows.append(
        (
            "loops",
            f"{motion.reversals} reversals, {motion.cycles} cycles, {motion.closed_loops} closed loops "
            f"({motion.major} major, {motion.minor} minor, {motion.nested} nested), {len(motion.strokes)} amplitudes, "
            f"{motion.holds} holds",
        )
    )
    if shape is not None:
        closing = "unknown" if shape.closure_percent is None else f"{shape.closure_percent:+.2f} %"
        rows.append(
            (
                "shape",
                f"width {shape.width:.4g} {units['y']} ({shape.width_percent:.1f} % of the stroke), "
                f"{shape.circulation or 'no open loop'}, closure {closing}, asymmetry {shape.asymmetry_percent:.1f} %",
            )
        )
    drift, lag = record.drift, record.lag
    rows.append(
        ("drift", DRIFTLESS if drift is None else f"{drift.per_cycle:.3g} {units['y']} per cycle ({drift.law})")
    )
    rows.append(("lag", "unknown" if lag is None else f"{lag.samples:.2f} +- {lag.stderr:.2f} samples"))
    return [f"  {record.name}", *(f"    {label:<10} {told}" for label, told in rows)]
