"""What the user adds to a file: sampling rate, units, standard deviations, integration and smoothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.data.preparation import EVEN, CoarseClock, RoundedStamps, interval_of
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Severity
from hystfit.params.units import conversion, parse_unit


@dataclasses.dataclass(frozen=True)
class Treatment:
    """Changes of a record after it was read, in this order: clock, units, integration, smoothing.

    Attributes:
        rate: sampling rate [Hz]; dt: sampling interval [s]. One of them, for a file without a usable clock.
        units: of input and output, "V,um" or ("V", "um"); an empty one is as in the file.
        integrate: replace the output by its integral over time.
        smooth: length of the zero-phase filter of the input, samples; None does not filter.

    Raises:
        DataError: both rate and interval, one that is not positive, or units that are not a pair.
    """

    rate: float | None = None
    dt: float | None = None
    units: str | Sequence[str] | None = None
    integrate: bool = False
    smooth: int | None = None

    def __post_init__(self) -> None:
        interval_of(self.rate, self.dt)
        if self.units is not None and len(self._pair()) != 2:
            raise DataError(f"units are those of input and output, such as V,um; got {self.units!r}")

    @property
    def interval(self) -> float | None:
        """Sampling interval chosen by the user [s]; None where there is none."""
        return interval_of(self.rate, self.dt)

    def _pair(self) -> list[str]:
        units = self.units or ()
        return [unit.strip() for unit in (units.split(",") if isinstance(units, str) else units)]

    def of(self, record: Record, stated: float | None = None) -> Record:
        """The record with these changes, each of them noted.

        Args:
            stated: sampling interval that the file of a record without time states [s], used where the user gives none.

        Raises:
            DataError: a usable clock of another rate, a unit of another quantity, or a change that the record does not admit.
        """
        if stated is not None and record.t is None and self.interval is None:
            words = f"time from the sampling interval that the header states: {stated:.6g} s"
            record = record.replace(t=stated * np.arange(len(record)), t_unit="s").noted(Code.PREPARED, words)
        record = self._timed(record)
        if self.units is not None:
            record = _relabeled(record, *self._pair())
        if self.integrate:
            record = record.integrated()
        return record if self.smooth is None else record.smoothed(self.smooth)

    def _timed(self, record: Record) -> Record:
        clock = None if record.t is None else CoarseClock.of(record.t)
        if self.interval is None:
            return _even(record) if clock is None else _untimed(record, clock)
        present = record.sampling_interval
        if clock is not None or present is None:
            return record.sampled(dt=self.interval)
        present *= conversion(record.t_unit, "s") or 1.0
        if abs(present - self.interval) > EVEN * self.interval:
            raise DataError(
                f"record {record.name!r}: the time column has {1 / present:.6g} samples per second, and the sampling rate "
                f"given is {1 / self.interval:.6g} Hz: leave out the rate, or read without time (time=False)"
            )
        return record


def _even(record: Record) -> Record:
    """The record with the times of its samples where rounded stamps are those of even ones."""
    found = None if record.t is None else RoundedStamps.of(record.t)
    if found is None:
        return record
    text = (
        f"time stamps are rounded to {found.resolution:g} {record.t_unit}, and those of samples every {found.interval:.6g} "
        f"{record.t_unit}, whose times are used"
    )
    return record.replace(t=found.samples(len(record))).noted(Code.PREPARED, text)


def _untimed(record: Record, clock: CoarseClock) -> Record:
    """The record without time stamps that repeat, with a warning that says how to give the sampling rate."""
    seconds = clock.step * (conversion(record.t_unit, "s") or 1.0)
    rate = f"{clock.samples / seconds:.6g}"
    text = (
        f"time stamps advance by {clock.step:g} {record.t_unit} every {clock.samples:g} samples: the time of each sample is "
        f"unknown, and the record is used without time. If the samples are evenly spaced, give their rate: --rate {rate} (rate={rate})"
    )
    return record.replace(t=None, t_unit="s").noted(Code.COARSE_CLOCK, text, Severity.WARNING)


def _relabeled(record: Record, u: str, y: str) -> Record:
    """The record in the units that the user gave; a unit of the file that is not known is replaced."""
    for field, role, unit in (("u_unit", "input", u), ("y_unit", "output", y)):
        old = getattr(record, field)
        if unit and not old:
            text = f"the unit of the {role} is {unit}, which was chosen by the user"
            record = record.replace(**{field: unit}).noted(Code.UNITS, text)
        if unit and old and old != unit and (parse_unit(old) is None or parse_unit(unit) is None):
            text = f"the unit {old!r} of the file is replaced by {unit!r}, as given by the user"
            record = record.replace(**{field: unit}).noted(Code.UNITS, text)
    return record.in_units(u, y)


def weighted(record: Record, sigma: np.ndarray, unit: str) -> Record:
    """The record with weights from the standard deviations in another column.

    Args:
        sigma: standard deviation of the output of each sample, shape (T,) [unit].
        unit: of that column; "" for that of the output.

    Raises:
        DataError: a standard deviation that is not positive, or a unit of another quantity.
    """
    factor = conversion(unit, record.y_unit) if unit and record.y_unit else 1.0
    return record.with_sigma(sigma * (1.0 if factor is None else factor))


UNTREATED = Treatment()
