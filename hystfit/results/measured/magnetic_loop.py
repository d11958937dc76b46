"""Field and polarization of a measured magnetic loop, with the corrections of the standards in their order, each reported.

The order is volume, image, drift, demagnetization, offsets, high-field slope. Volume, image and demagnetization follow from the sample;
the others are applied where they are asked for, and else only estimated.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection

import numpy as np

from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome.table import or_none, with_error
from hystfit.params.units import MU0, size_in
from hystfit.results.measured.loop_branches import (
    Branch,
    Found,
    asymmetry,
    center_at,
    large_branches,
    mean_ends,
    turns_of,
)
from hystfit.results.measured.magnetic_sample import Sample
from hystfit.results.measured.saturation_law import Saturation, saturation
from hystfit.results.measured.steady_branches import at_one_pace

ON_REQUEST = ("drift", "offset", "slope")
_POLARIZATION = re.compile(r"(?:mu_?0|µ0|μ0)?\s*[JIM](?:\b|_| )|.*polari[sz]ation|.*magneti[sz]ation", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class Correction:
    """One correction of a magnetic loop."""

    name: str  # "volume", "image", "drift", "demagnetization", "offset" or "slope"
    text: str  # what it is
    value: float | None  # value, stderr, unit: its size; None where unknown
    stderr: float | None
    unit: str
    applied: bool  # whether the quantities are those after it

    def __str__(self) -> str:
        size = "" if self.value is None else f" {with_error(self.value, self.stderr, self.unit)}"
        return f"{self.name}:{size}, {self.text}" + ("" if self.applied else "; not applied")


@dataclasses.dataclass(frozen=True, eq=False)
class MagneticLoop:
    """A loop in SI units."""

    h: np.ndarray  # field [A/m], shape (T,)
    j: np.ndarray  # polarization [T]; where the volume is unknown, the output as in the file
    t: np.ndarray | None  # time, in the unit of the record
    noise: float  # standard deviation of the noise of j; NaN where unknown
    absolute: bool  # whether j is in T
    branches: tuple[Branch, ...]  # between turning points over nearly the whole range of the field
    corrections: tuple[Correction, ...]  # in order
    saturation: Saturation | None  # by the law of approach; None where there are too few samples
    units: tuple[str, str]  # of field and output in the file
    per_field: float  # size of that of the field [A/m]

    @classmethod
    def of(
        cls, record: Record, sample: Sample, noise: float = np.nan, correct: Collection[str] = ()
    ) -> MagneticLoop | None:
        """The loop of a record; None where its input is no magnetic field, or has no unit.

        Args:
            record: input a field in A/m, Oe or T (mu0 H); output a moment, a magnetization, a polarization or a flux density.
            sample: what is known of the sample, beside the header of the file.
            noise: standard deviation of the white noise, in the unit of the output; NaN where it is unknown.
            correct: which of `ON_REQUEST` to apply.
        """
        if unknown := set(correct) - set(ON_REQUEST):
            raise DataError(f"no correction {sorted(unknown)[0]!r}; there are {', '.join(ON_REQUEST)}")
        if (field := size_in(record.u_unit, "A/m", "T")) is None:
            return None
        sample = sample.with_header(record.metadata)
        per_field = field[1] / (MU0 if field[0] == "T" else 1.0)
        h, y = per_field * record.u[record.used], record.y[record.used]
        factor, corrections = _to_polarization(record, sample)
        if sample.image is not None:
            factor = None if factor is None else factor / sample.image
            y = y if factor is not None else y / sample.image
            corrections.append(Correction("image", "images in the poles", sample.image, None, "", True))
        scale = 1.0 if factor is None else factor
        is_flux = size_in(record.y_unit, "T") is not None and not _POLARIZATION.match(record.y_name)
        j = scale * y - (MU0 * h if is_flux else 0.0)
        units = (record.u_unit, record.y_unit)
        t = None if record.t is None else record.t[record.used]
        made = cls(h, j, t, scale * noise, factor is not None, (), tuple(corrections), None, units, per_field)
        return made._drift("drift" in correct)._demagnetized(sample)._centered("offset" in correct)._sloped("slope" in correct)  # fmt: skip

    def _with(self, correction: Correction | None = None, **changes: object) -> MagneticLoop:
        listed = self.corrections if correction is None else (*self.corrections, correction)
        made = dataclasses.replace(self, corrections=listed, **changes)  # type: ignore[arg-type]
        turns = turns_of(made.h)
        found = at_one_pace(large_branches(made.h, made.j, turns, made.t))[0] if turns.size else ()
        return dataclasses.replace(made, branches=tuple(found))

    @property
    def unit(self) -> str:
        """Of j."""
        return "T" if self.absolute else self.units[1]

    @property
    def sigma(self) -> float:
        """Standard deviation of one output [T]: of its white noise, or of the asymmetry of the loop where that is larger."""
        return self._scatter[0]

    @property
    def correlated(self) -> float:
        """Over which stretch of the field that scatter is correlated [A/m]; 0 where it is white noise."""
        return self._scatter[1]

    @property
    def _scatter(self) -> tuple[float, float]:
        found = asymmetry(list(self.branches))
        return found if found[0] > np.nan_to_num(self.noise) else (self.noise, 0.0)

    def _drift(self, apply: bool) -> MagneticLoop:
        """The gap at the tip of the first closed cycle, removed in proportion to the number of samples."""
        edges = [0, *turns_of(self.h).tolist(), self.h.size - 1]
        tops = [
            k
            for k in range(len(edges) - 2)
            if min(abs(self.h[edges[k + i + 1]] - self.h[edges[k + i]]) for i in (0, 1)) > 0.9 * np.ptp(self.h)
        ]
        if not tops:
            return self._with()
        first, last = edges[tops[0]], edges[tops[0] + 2]
        gap = float(self.j[last] - self.j[first])
        removed = gap * np.arange(self.h.size) / (last - first) if apply else 0.0
        error = or_none(np.sqrt(2) * self.noise)
        found = Correction("drift", "gap at the tip after one cycle", gap, error, self.unit, apply)
        return self._with(found, j=self.j - removed)

    def _demagnetized(self, sample: Sample) -> MagneticLoop:
        known = sample.known_factor
        if known is None or not self.absolute:
            return self
        text = f"factor N {known[1]}: H = Ha - N M"
        return self._with(
            Correction("demagnetization", text, known[0], None, "", True), h=self.h - known[0] * self.j / MU0
        )

    def _centered(self, apply: bool) -> MagneticLoop:
        """Half sums of the outputs at the ends, and of the fields where the branches cross their middle."""
        if not self.branches:
            return self
        level, error = self._middle()
        made = self._with(
            Correction("offset", "of the output: half sum of its ends", level, or_none(error), self.unit, apply),
            j=self.j - (level if apply else 0.0),
        )
        shift, error = center_at(level, self.branches, self.noise)
        if not np.isfinite(shift):
            return made
        text, per, unit = "of the field: half sum of both crossings", self.per_field, self.units[0]
        found = Correction("offset", text, shift / per, or_none(error / per), unit, apply)
        return made._with(found, h=made.h - (shift if apply else 0.0))

    def _sloped(self, apply: bool) -> MagneticLoop:
        law = saturation(list(self.branches))
        if law is None:
            return self
        slope, error = law.slope / (MU0 if self.absolute else 1.0), law.slope_stderr / (MU0 if self.absolute else 1.0)
        text = "high-field susceptibility, of J = Js - a/H + chi H"
        found = Correction("slope", text, slope, error, "" if self.absolute else "per A/m", apply and law.settled)
        made = self._with(found, j=self.j - (law.slope * self.h if found.applied else 0.0))
        return dataclasses.replace(made, saturation=law)

    def _middle(self) -> Found:
        """Half sum of the mean outputs at both ends, and its error."""
        largest = min(float(self.h.max()), -float(self.h.min()))
        (high, low), error = mean_ends(self.branches, -largest, largest, self.noise)
        if not (largest > 0 and np.isfinite(high + low)):
            return 0.5 * float(self.j.max() + self.j.min()), np.nan
        return 0.5 * (high + low), error


def _to_polarization(record: Record, sample: Sample) -> tuple[float | None, list[Correction]]:
    """Factor from the output to T, None where it is unknown, and the correction for the volume."""
    kind, size = size_in(record.y_unit, "T", "A/m", "A*m^2/kg", "A*m^2") or ("", 0.0)
    if kind in ("T", "A/m"):
        return size * (MU0 if kind == "A/m" else 1.0), []
    if kind == "A*m^2/kg" and sample.density is not None:
        found = Correction("volume", "density of the sample", 1e-3 * sample.density, None, "g/cm3", True)
        return MU0 * size * sample.density, [found]
    volume = sample.known_volume
    if kind != "A*m^2" or volume is None:
        return None, []
    text = volume[1]
    if sample.mass is not None and sample.density is None:
        text += f"; the mass then gives a density of {1e-3 * sample.mass / volume[0]:.4g} g/cm3"
    return MU0 * size / volume[0], [Correction("volume", text, 1e9 * volume[0], None, "mm3", True)]
