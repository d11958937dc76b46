"""Findings on the quality of a record, as notes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

from hystfit.outcome.merged_notes import merged
from hystfit.outcome.note import Code, Note, warn
from hystfit.params.units import quantity
from hystfit.quality.damage import FAILED
from hystfit.quality.determination import few_samples
from hystfit.quality.faults import CLEAR, MOST
from hystfit.quality.record_quality import OF_CHARGE, OF_ENTHALPY, RecordQuality
from hystfit.quality.resonance import Dynamics

# Decades over which three quarters of a column extend, from which its logarithm is the quantity to fit: suctions of soils, resistances of a
# transition and currents of a transistor have 2.0 to 6, loads, fields and the pressures of most isotherms less than 1.8.
_DECADES = 2.0
INTEGRATED = ("integrate", "true")  # option that reads a current as the charge, or a voltage as the flux
AFTER_FAILURE = f"later strokes, at least as long, stay below {100 * FAILED:.0f} % of the largest force (ASTM E2126)"
CONTROLLED = warn(
    Code.COLUMN_CHOICE,
    "the output reverses at constant levels and the input does not: the test controlled the output, such as the load of a cyclic "
    "triaxial or ratcheting test. A model must be driven by the controlled quantity: exchange the columns (input=, output=)",
)
WITHOUT_TIME = (
    "models that depend on time (creep, lag, delay, relaxation, viscous terms, oscillator) cannot be fitted; rate= gives "
    "the time of evenly spaced samples"
)


def findings(records: Sequence[RecordQuality]) -> tuple[Note, ...]:
    """Faults and noteworthy properties of the data.

    Equal notes are merged, and many that differ in their numbers alone; a note names its records where it does not hold for all.
    """
    span = max((record.y.range for record in records), default=0.0)
    by_record = {
        record.name: itertools.chain(
            _faults(record),
            _noise(record, span),
            scale_notes(record.u.decades, record.y.decades),
            _response(record),
            _loops(record, alone=len(records) == 1),
            _changes(record),
        )
        for record in records
    }
    few = few_samples(records)
    return (*([few] if few else []), *merged(by_record, len(records)))


def _faults(record: RecordQuality) -> Iterator[Note]:
    """Faults of single samples and of the time axis."""
    sampling = record.sampling
    if sampling.rate is None:
        yield warn(Code.NO_TIME, f"no usable time: lag and creep are unknown, and {WITHOUT_TIME}")
    elif not sampling.uniform:
        yield warn(Code.TIME_STEPS, "uneven time steps: the lag is not estimated")
    if sampling.repeated_stamps:
        yield warn(Code.TIME_STEPS, f"repeated time stamps: {sampling.repeated_stamps}")
    if sampling.gaps:
        yield warn(Code.TIME_STEPS, f"gaps in time (more than 1.5 steps): {sampling.gaps}")
    if sampling.missing:
        share = 100 * sampling.missing / sampling.n
        yield warn(Code.MISSING_VALUES, f"missing outputs: {sampling.missing} samples ({share:.1f} %)")
    if record.clipped:
        yield warn(
            Code.CLIPPED,
            f"{record.clipped} samples of the output stay at its limit while the input moves: check for a saturated "
            "sensor; fits leave them out where the output reaches this limit with a steep slope",
        )
    elif record.flat_ends:
        yield warn(Code.CLIPPED, flat_words(record.flat_ends))
    if record.spikes:
        yield warn(
            Code.SPIKES,
            f"outliers (spikes) in the output: {record.spikes}; fits leave them out, and a robust loss (loss='huber') keeps them",
        )
    if record.motion.chatter_percent > MOST:
        yield chatter_note(record.motion.chatter_percent, record.motion.smoothing)


def chatter_note(percent: float, smoothing: int | None) -> Note:
    """That an input reverses because of noise, and what helps.

    Args:
        percent: share of the samples at which it steps back.
        smoothing: filter that makes them few [samples]; None without one.
    """
    remedy = "measure the input with less noise"
    if smoothing:
        remedy = f"--smooth {smoothing} (smooth={smoothing}) reduces them below {MOST:g} %"
    text = f"{percent:.0f} % of the input steps reverse direction because of noise, and each false reversal makes a small loop in a model"
    return warn(Code.CHATTER, f"{text}: {remedy}")


def _noise(record: RecordQuality, span: float) -> Iterator[Note]:
    """Noise of the output beside the largest range of the records, of which small loops and reversal curves are parts [y]."""
    noise, unit = record.y.known_noise, record.units["y"]
    if noise and span > 0 and noise > 0.02 * span:
        size = f"{noise:.3g} {unit}".rstrip()
        text = f"output noise: {size} rms, {100 * noise / span:.1f} % of the output range"
        if record.motion.monotonic:
            text += (
                "; or these are points of several branches sorted along the input, as from a digitized plot, and the order in which they "
                "were measured is lost"
            )
        yield warn(Code.OUTPUT_NOISE, text)


def scale_notes(u: float, y: float) -> Iterator[Note]:
    """Whether the input or the output extends over decades, of which u and y have this many."""
    for role, decades in (("input", u), ("output", y)):
        if decades > _DECADES - 1e-9:
            text = f"a quarter of the {role}s are below {10 ** (2 - decades):.2g} % of the largest, and hardly affect a fit"
            yield warn(Code.DECADES, f"{text}: write log10 of the {role} to the file and fit that")


def conducts(units: Mapping[str, str]) -> bool:
    """Whether records with these units of u and y are currents against voltages, as of electrodes and capacitors."""
    return (quantity(units["u"]), quantity(units["y"])) in OF_CHARGE


def flat_words(count: int) -> str:
    """A warning of level ends of a loop, which fits include."""
    return (
        f"{count} samples of the output stay level within the noise at an end of the loop, between two corners, while the input goes on, "
        "turns and comes back: a saturated sensor or amplifier, or a dead zone of the device. Fits include them; if the sensor was "
        "saturated, mark them as missing"
    )


def is_heat_flow(units: Mapping[str, str]) -> bool:
    """Whether records with these units of u and y are heat flows against temperatures, as of calorimeters."""
    return (quantity(units["u"]), quantity(units["y"])) in OF_ENTHALPY


def rate_note(units: Mapping[str, str], *, certain: bool, timed: bool = True) -> Note:
    """A note on an output whose integral makes the loop, see `is_rate`; where that is certain, with the option for it.

    Args:
        timed: whether the records have times; without them, the note is a warning.
    """
    made = "charge or polarization" if conducts(units) else "enthalpy" if is_heat_flow(units) else "flux or induction"
    text = f"the output is a {quantity(units['y'])} against a {quantity(units['u'])}: for a loop of {made}, "
    if not timed:
        text += (
            "integrate it over time with --integrate (integrate=True); rate= gives the time of evenly spaced samples"
        )
        return warn(Code.RATE, text)
    return Note(
        Code.RATE, f"{text}--integrate (integrate=True) integrates it over time", option=INTEGRATED if certain else None
    )


def _response(record: RecordQuality) -> Iterator[Note]:
    """How the output responds to the input, apart from the shape of loops."""
    if record.dynamics is not None and record.dynamic:
        yield warn(Code.DYNAMICS, _resonance(record.dynamics, record.units["t"]))
    if record.delay is not None:
        clock = f"{record.delay.seconds:.3g} {record.units['t']}".rstrip()
        yield Note(
            Code.DELAY,
            f"the output has a pure delay of {record.delay.samples:.1f} samples ({clock}): loops are analyzed with the input delayed by "
            "the same time, and models are fitted with delay+ in front",
        )
    if record.falls:
        yield Note(
            Code.FALLING,
            "the output falls as the input rises: loops are analyzed with the input mirrored, and models are fitted with negate+ in front",
        )
    if record.gains_energy:
        yield warn(
            Code.ENERGY_GAIN,
            f"the loop runs {record.circulation}, as if the device gave off energy in each cycle: check the signs of both columns, "
            "the order of the rows, and whether one channel lags the other",
        )
    if record.output_controlled:
        yield CONTROLLED
    timed = record.sampling.rate is not None
    if (timed and conducts(record.units)) or (record.is_rate and (timed or is_heat_flow(record.units))):
        yield rate_note(record.units, certain=record.is_rate, timed=timed)


def _loops(record: RecordQuality, *, alone: bool) -> Iterator[Note]:
    """Whether there are loops, and of which shape.

    Args:
        alone: whether there is no other record.
    """
    shape = record.shape
    if record.motion.monotonic:
        text = "the input is monotonic, so there is no loop"
        if alone:
            text += "; if this is one branch of a loop, give the files of all branches together (hystfit check RISING.csv FALLING.csv)"
        if quantity(record.units["u"]) in ("", "time"):
            text += "; if it is a time, read both signals from their files as INPUT.csv+OUTPUT.csv"
        yield warn(Code.NO_LOOP, text)
    if shape is None:
        return
    if shape.crossing:
        yield warn(
            Code.CROSSING,
            "the rising and falling branches cross, and the lobes circulate in opposite directions (a butterfly): only a model with "
            "weights of either sign (preisach-signed) describes this, and it has no inverse; or fit the signed quantity of which the "
            "output is an even function, or one half of the input range",
        )
    elif record.single_valued:
        text = "the rising and falling branches coincide: no hysteresis above the noise; fit a curve instead"
        yield warn(Code.SINGLE_VALUED, text)
    chance = 0.0 if record.y.range == 0 else 100 * CLEAR * (record.y.known_noise or 0.0) / record.y.range
    if shape.closure_percent is not None and abs(shape.closure_percent) > max(2.0, chance):
        yield warn(Code.NOT_CLOSED, f"the last large loop does not close: {shape.closure_percent:+.1f} % of its stroke")
    if record.degrading:
        until = record.whole_until
        whole = "" if until is None else f"; no damage is seen before {place_of(until, record)}"
        yield warn(
            Code.DEGRADING,
            f"loss of {_loss(record)}; models without terms for damage cannot describe this: fit one that has them (such as "
            f"self-similar-stops), or the cycles {'after the largest stroke' if record.softens_with_stroke else 'before the damage'} "
            f"(window=){whole}",
        )
    if record.fails_at is not None:
        place = place_of(record.fails_at, record)
        yield warn(Code.FAILURE, f"the device fails at {place}: {AFTER_FAILURE}; fit the part before it (window=)")


def place_of(at: float, record: RecordQuality) -> str:
    """A sample or a time of a record, in words."""
    return f"sample {at:.10g}" if record.sampling.rate is None else f"{at:.10g} {record.units['t']}".rstrip()


def _loss(record: RecordQuality) -> str:
    """What a damaged device loses, and how much of it is left."""
    percent = lambda part: f"{100 * (part or 0.0):.0f} %"
    if record.softens_with_stroke:
        left = percent(record.softening_left)
        return f"stiffness with the largest stroke so far (Mullins effect): later branches reach {left} of the output of earlier ones"
    if record.weakens:
        left = percent(record.strength_left)
        return f"strength (damage): late loops reach {left} of the output of earlier, shorter ones"
    if record.softens:
        left = percent(record.unloading_left)
        return f"stiffness (damage): after late reversals, {left} of the initial unloading stiffness remains"
    left = percent(record.stiffness_left)
    if quantity(record.units["y"]) not in ("force", "stress", ""):
        return f"output (fatigue): late loops have {left} of the initial slope at the same stroke"
    return f"stiffness (damage or backlash): late loops have {left} of the initial stiffness at the same stroke"


def _changes(record: RecordQuality) -> Iterator[Note]:
    """Dependence on time and speed: drift, lag, velocity."""
    shape, drift, lag = record.shape, record.drift, record.lag
    charge = quantity(record.units["y"]) in ("charge", "polarization")
    if drift is not None and drift.law != "none":
        slope, per, r2 = drift.per_cycle, "cycle", drift.r2_linear
        if drift.law == "logarithmic" and drift.per_decade is not None and drift.r2_log is not None:
            slope, per, r2 = drift.per_decade, "decade of time", drift.r2_log
        size = f"{slope:.3g} {record.units['y']}".rstrip()
        text = f"the mean of similar cycles drifts by {size} per {per} ({drift.law}, R2 {r2:.3f})"
        large = shape is not None and abs(drift.total) > 0.3 * shape.width
        more = "; in total this is comparable to the width of the loop: model it (creep) or remove it" if large else ""
        yield warn(Code.DRIFT, text + more)
    if lag is not None and record.lags and record.slow_lag is None and not record.dynamic:
        clock = "" if lag.seconds is None else f" ({lag.seconds:.3g} {record.units['t']})"
        yield warn(
            Code.LAG,
            f"the output lags the input by {lag.samples:.1f} +- {lag.stderr:.1f} samples{clock} at the reversals: a delay, a "
            f"fast lag{', leakage' if charge else ''} or creep, not hysteresis",
        )
    if record.slow_lag is not None and not record.is_rate:
        clock = f"{record.slow_lag / (record.sampling.rate or 1.0):.3g} {record.units['t']}".rstrip()
        yield warn(
            Code.LAG,
            f"the output follows the input with a lag of about {record.slow_lag:.2g} samples ({clock}), which widens the loop: model it "
            "(lag) or measure at a lower frequency",
        )
    if record.speed_dependent:
        reason = "the area of the loop changes with frequency"
        if lag is not None and record.leads:
            reason = f"it reverses {-lag.samples:.1f} samples before the input"
        yield warn(Code.SPEED_DEPENDENT, f"the output depends on the input's speed ({reason}): add a velocity term")


def _resonance(found: Dynamics, unit: str) -> str:
    rate = "Hz" if unit == "s" else f"per {unit or 'unit of time'}"
    return (
        f"the response changes with frequency: from {found.low:.3g} to {found.high:.3g} {rate} the gain changes by a factor of "
        f"{found.gain_ratio:.2g} and the phase from {found.phase_low:.0f} to {found.phase_high:.0f} degrees. A resonance at "
        f"{found.natural_frequency:.3g} {rate} (damping ratio {found.damping_ratio:.2g}) explains {100 * found.explained:.0f} % of the "
        "variance that hysteresis, lag and velocity terms do not: use oscillator, or second-order after a hysteresis"
    )
