"""What is wrong with the data or worth knowing, in words, and the page that says so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hystfit.quality.verdict import degrades, depends_on_speed, moves_on

if TYPE_CHECKING:
    from hystfit.quality.quality import QualityReport, RecordQuality


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
    if lag is not None and moves_on(record):
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
