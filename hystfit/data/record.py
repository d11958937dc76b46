"""A measured or simulated loop on the host: `Record`, one run of an experiment."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.data.circulation import GAP
from hystfit.data.preparation import check_columns, column, integral, interval_of, smooth
from hystfit.errors import DataError
from hystfit.outcome import Code, Note, Severity
from hystfit.params.units import conversion, integral_unit

# Labels of the line that was added to the output before the other results were computed: per unit of the input, and at zero input.
SLOPE, OFFSET = "Slope correction", "Offset correction"


@dataclasses.dataclass(frozen=True)
class Stated:
    """One result as the file states it, with the label and unit there; `quantity` names one of `QUANTITIES`, "" where it is none."""

    label: str
    value: float
    unit: str = ""
    quantity: str = ""


def median_interval(steps: np.ndarray) -> float | None:
    """Median of the positive time steps; None where no step is positive."""
    positive = steps[steps > 0]
    return float(np.median(positive)) if positive.size else None


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """One run of an experiment: input `u`, output `y`, maybe time `t`, and which samples count.

    Attributes:
        u: input, shape (T,), finite.
        y: output, shape (T,); NaN marks a missing measurement (it is simulated, never fitted).
        t: time of each sample [t_unit], shape (T,), non-decreasing; None where there is none.
        weight: shape (T,), 0 where the sample does not count in a fit or a metric; else 1, or relative to `sigma`.
        u_unit, y_unit, t_unit: units as written in reports; "" if unknown.
        u_name, y_name: names of the columns.
        name: name of the record in reports and per-record parameters.
        source: origin (a path, a data set, "simulated").
        sha256: checksum of the file that it was read from; None if it was not read from a file.
        sigma: standard deviation of the output of a sample of weight 1 [y_unit]; None if unknown (see `with_sigma`).
        reading: options of `hystfit.read` other than the defaults, by name, as at the shell.
        metadata: properties of the sample by name (size, mass, temperature): of the header of its file, and columns that are constant.
        stated: results that the instrument computed from this loop and wrote into its file.
        notes: what was assumed, left out or changed when the record was read or prepared.

    Raises:
        DataError: lengths differ, fewer than two samples, no finite output, non-finite input or decreasing time.
    """

    u: np.ndarray
    y: np.ndarray
    t: np.ndarray | None = None
    weight: Any = None  # an array once made
    u_unit: str = ""
    y_unit: str = ""
    t_unit: str = "s"
    u_name: str = "u"
    y_name: str = "y"
    name: str = "record"
    source: str = ""
    sha256: str | None = None
    sigma: float | None = None
    reading: Mapping[str, str] = dataclasses.field(default_factory=dict)
    metadata: Mapping[str, str] = dataclasses.field(default_factory=dict)
    stated: tuple[Stated, ...] = ()
    notes: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        put = lambda field, value: object.__setattr__(self, field, value)
        put("u", column("input u", self.u))
        put("y", column("output y", self.y))
        if self.t is not None:
            put("t", column("time t", self.t))
        weight = np.ones(self.u.size) if self.weight is None else self.weight
        put("weight", column("weight", weight))
        check_columns(self.name, self.u, self.y, self.t, self.weight)
        if self.sigma is not None and not (np.isfinite(self.sigma) and self.sigma > 0):
            raise DataError(f"record {self.name!r}: sigma must be a positive number, got {self.sigma}")

    def __len__(self) -> int:
        return self.u.size

    def __repr__(self) -> str:
        unused = len(self) - int(self.used.sum())
        parts = [f"{len(self)} samples" + (f" ({unused} unused)" if unused else "")]
        parts += [
            f"{name} {np.nanmin(values):.4g} to {np.nanmax(values):.4g} {unit}".rstrip()
            for name, values, unit in (
                (self.u_name, self.u, self.u_unit),
                (self.y_name, self.y, self.y_unit),
                ("time", self.t, self.t_unit),
            )
            if values is not None
        ]
        return f"<Record {self.name!r}: {', '.join(parts)}>"

    @functools.cached_property
    def used(self) -> np.ndarray:
        """Samples that count: positive weight and a measured output, shape (T,), bool, read-only."""
        used = (self.weight > 0) & np.isfinite(self.y)
        used.flags.writeable = False
        return used

    @property
    def reached(self) -> np.ndarray:
        """Inputs from the first to the last sample that counts, shape (n,): those between that do not count drove the device too."""
        return self.u[self.first : self.last + 1] if self.used.any() else self.u[:0]

    @property
    def first(self) -> int:
        """The first sample that counts."""
        return int(np.argmax(self.used))

    @property
    def last(self) -> int:
        """The last sample that counts."""
        return len(self) - 1 - int(np.argmax(self.used[::-1]))

    @property
    def rate_known(self) -> np.ndarray:
        """Samples at which the rate of the input is known, shape (T,), bool: not the first one where the record begins in motion."""
        known = np.ones(len(self), dtype=bool)
        known[:1] = len(self) < 2 or self.u[1] == self.u[0]
        return known

    @property
    def dt(self) -> np.ndarray:
        """Time over which each input acts before its sample is read [t_unit], shape (T,); all 0 where there is no time.

        That is the time since the previous sample, and for the first sample the sampling interval.
        """
        if self.t is None:
            return np.zeros(len(self))
        return np.concatenate([[self.sampling_interval or 0.0], np.diff(self.t)])

    @functools.cached_property
    def sampling_interval(self) -> float | None:
        """Median of the positive time steps [t_unit]; None without time."""
        return None if self.t is None else median_interval(np.diff(self.t))

    def replace(self, **changes: object) -> Record:
        """Copy with some fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def noted(self, code: Code, text: str, severity: Severity = Severity.INFO) -> Record:
        """Copy with one more note, which is not repeated.

        Args:
            code: of the note.
            text: one sentence.
            severity: of the note.
        """
        note = Note(code, text, severity)
        return self if note in self.notes else self.replace(notes=(*self.notes, note))

    def window(self, start: float | None = None, stop: float | None = None) -> Record:
        """The same record in which only samples with start <= t < stop count.

        The input before the window still drives the model, so that its state is right where the window begins.
        Limits are in t_unit where the record has time, sample numbers where it has none; None leaves a side open.

        Raises:
            DataError: no sample lies in the window.
        """
        axis = np.arange(len(self)) if self.t is None else self.t
        inside = (axis >= (-np.inf if start is None else start)) & (axis < (np.inf if stop is None else stop))
        weight = np.where(inside, self.weight, 0.0)
        if not (inside & self.used).any():
            unit = "samples" if self.t is None else self.t_unit
            raise DataError(
                f"record {self.name!r}: no usable sample between {start} and {stop} {unit}; "
                f"the record runs from {axis[0]:g} to {axis[-1]:g}"
            )
        return self.replace(weight=weight)

    def resting_on(self, u0: float) -> Record:
        """Prepend an unmeasured sample: the device is in equilibrium at the input `u0` before the record begins.

        The model is then driven through the step from u0 to the first input. Without it, it starts in equilibrium at the
        first input, and creep after a switch-on remains unexplained.

        Raises:
            DataError: the input is not finite.
        """
        if not np.isfinite(u0):
            raise DataError(f"the input at rest must be finite, got {u0}")
        t = None if self.t is None else np.concatenate([[self.t[0] - self.dt[0]], self.t])
        before = lambda value, column: np.concatenate([[value], column])
        longer = self.replace(u=before(u0, self.u), y=before(np.nan, self.y), t=t, weight=before(0.0, self.weight))
        level = f"{u0:g} {self.u_unit}".rstrip()
        return longer.noted(Code.PREPARED, f"assumed in equilibrium at an input of {level} before the record begins")

    def repeating(self, cycles: int = 1, period: int | None = None) -> Record:
        """Prepend the first period of the record as unmeasured samples: the motion has long been steady.

        The state before the first sample is then the one after the cycle, and no virgin branch. One cycle is enough for models
        with return-point memory (plays, stops, Preisach); others take several.

        Args:
            cycles: number of periods.
            period: samples of one; None where the record is one period.

        Raises:
            DataError: the input does not come back to where it began.
        """
        count = len(self) if period is None else period
        gap = abs(float(self.u[min(count, len(self) - 1)] - self.u[0]))
        if cycles < 1 or gap > GAP * float(np.ptp(self.u)):
            raise DataError(
                f"record {self.name!r} is not a period of a cycle: its input begins at {self.u[0]:g} and ends at {self.u[-1]:g} "
                f"{self.u_unit}".rstrip()
            )
        before = lambda column, value: np.concatenate([np.full(cycles * count, value), column])
        t = self.t
        if t is not None:
            duration = t[count] - t[0] if count < len(self) else t[-1] - t[0] + self.dt[-1]
            t = np.concatenate([*(t[:count] - k * duration for k in range(cycles, 0, -1)), t])
        u = np.concatenate([np.tile(self.u[:count], cycles), self.u])
        longer = self.replace(u=u, y=before(self.y, np.nan), t=t, weight=before(self.weight, 0.0))
        times = "once" if cycles == 1 else f"{cycles} times"
        text = f"begins in a steady cycle: driven through its first period {times} before"
        return longer.noted(Code.PREPARED, text)

    def sampled(self, rate: float | None = None, dt: float | None = None) -> Record:
        """Copy whose samples are evenly spaced in time from 0 s on; any other time is replaced.

        Args:
            rate: sampling rate [Hz].
            dt: sampling interval [s]; give one of the two.

        Raises:
            DataError: neither or both are given, or the value is not positive.
        """
        interval = interval_of(rate, dt)
        if interval is None:
            raise DataError("a sampling rate or a sampling interval is needed")
        timed = self.replace(t=interval * np.arange(len(self)), t_unit="s")
        text = f"time from a sampling rate of {1 / interval:.6g} Hz (interval {interval:.6g} s), as given by the user"
        return timed.noted(Code.PREPARED, text)

    def with_sigma(self, sigma: Any) -> Record:
        """Copy whose samples have the weight 1/sigma^2, relative to the median of sigma.

        Only the ratios matter to a fit; the size of the noise is estimated from the residuals.

        Args:
            sigma: standard deviation of the output of each sample, shape (T,) [y_unit].

        Raises:
            DataError: a standard deviation is not a positive number where the sample counts.
        """
        sigma = column("sigma", sigma)
        if sigma.size != len(self):
            raise DataError(f"record {self.name!r}: {sigma.size} standard deviations for {len(self)} samples")
        bad = self.used & ~(np.isfinite(sigma) & (sigma > 0))
        if bad.any():
            raise DataError(
                f"record {self.name!r}: {int(bad.sum())} standard deviations are not positive numbers, the first "
                f"({sigma[bad][0]:g}) at sample {int(np.argmax(bad))}"
            )
        known = sigma[self.used]
        middle = float(np.median(known))
        weight = np.where(self.used, self.weight, 0.0)
        weight[self.used] *= (middle / known) ** 2
        weighted = self.replace(weight=weight, sigma=middle)
        unit = f" {self.y_unit}".rstrip()
        text = f"samples are weighted by standard deviations of {known.min():.4g} to {known.max():.4g}{unit}"
        return weighted.noted(Code.WEIGHTED, text)

    def smoothed(self, length: int) -> Record:
        """Copy with a smoothed input (zero phase: it is not delayed), see `hystfit.data.preparation.smooth`.

        Args:
            length: number of samples, odd and at least 5.

        Raises:
            DataError: the length is even, too small, or larger than the record.
        """
        u = smooth(self.u, length)
        changed = f"{np.sqrt(np.mean((u - self.u) ** 2)):.3g} {self.u_unit}".rstrip()
        text = f"input smoothed by a zero-phase Savitzky-Golay filter of {length} samples (changes it by {changed} rms)"
        return self.replace(u=u).noted(Code.PREPARED, text)

    def integrated(self) -> Record:
        """Copy whose output is the integral of the output over time (the charge of a current), by the trapezoidal rule.

        It begins at 0, and no mean is subtracted.

        Raises:
            DataError: no time, a missing output, or standard deviations, which do not apply to an integral.
        """
        if self.t is None:
            raise DataError(f"record {self.name!r} has no time, which an integral needs: give rate= or dt=")
        if self.sigma is not None:
            raise DataError(f"record {self.name!r}: standard deviations of the output do not apply to its integral")
        if missing := int(np.isnan(self.y).sum()):
            raise DataError(f"record {self.name!r}: {missing} outputs are missing, which cannot be integrated over")
        factor = conversion(self.t_unit, "s")
        unit = f"{self.y_unit}*{self.t_unit}" if factor is None else integral_unit(self.y_unit)
        y = integral(self.y, self.t * (factor or 1.0))
        drift = f"{y[-1]:.4g} {unit}".rstrip()
        text = (
            f"output {self.y_name!r} integrated over time; its mean was not subtracted, and the integral ends {drift} "
            "above its start"
        )
        whole = self.replace(y=y, y_unit=unit, y_name=f"integral of {self.y_name}")
        return whole.noted(Code.PREPARED, text)

    def in_units(self, u: str = "", y: str = "", t: str = "") -> Record:
        """Copy in other units of the same quantities; a column whose unit is unknown is assumed to be in the new unit.

        Args:
            u, y, t: new units of input, output and time; "" keeps the unit.

        Raises:
            DataError: a new unit belongs to another quantity.
        """
        record = self
        for role, symbol, unit in (("input", "u", u), ("output", "y", y), ("time", "t", t)):
            values, old = getattr(record, symbol), getattr(record, f"{symbol}_unit")
            if not unit or unit == old or values is None:
                continue
            try:
                factor = conversion(old, unit)
            except DataError as error:
                raise DataError(f"record {self.name!r}: the {role} has another unit: {error}") from error
            if factor is None and old:
                text = (
                    f"the {role} is in {old!r}, which cannot be converted to {unit!r}: its numbers are used unchanged"
                )
                record = record.noted(Code.UNITS, text, Severity.WARNING)
                continue
            changes: dict[str, Any] = {f"{symbol}_unit": unit}
            text = f"the unit of the {role} of {self.name!r} is unknown: {unit} is assumed"
            if factor is not None:
                changes[symbol] = values * factor
                text = f"{role} converted from {old} to {unit}"
                if symbol == "y" and record.sigma is not None:
                    changes["sigma"] = record.sigma * factor
            record = record.replace(**changes).noted(Code.UNITS, text)
        return record

    def segment(self, start: int, stop: int) -> Record:
        """Samples start <= i < stop as a separate record, without the input before them."""
        return self.take(slice(start, stop))

    def take(self, samples: slice | np.ndarray) -> Record:
        """The record of some samples only: a slice, a mask of shape (T,) or sample numbers."""
        t = None if self.t is None else self.t[samples]
        return self.replace(u=self.u[samples], y=self.y[samples], t=t, weight=self.weight[samples])

    def blocks(self, count: int) -> list[np.ndarray]:
        """Split the samples that count into contiguous blocks of about equal size: one boolean mask (T,) each."""
        return [np.isin(np.arange(len(self)), part) for part in np.array_split(np.flatnonzero(self.used), count)]

    def digest(self) -> str:
        """SHA-256 of the numbers, independent of file format and labels."""
        return self._digest

    @functools.cached_property
    def _digest(self) -> str:
        hasher = hashlib.sha256()
        for values in (self.u, self.y, self.t, self.weight):
            hasher.update(b"-" if values is None else np.ascontiguousarray(values))
        return hasher.hexdigest()
