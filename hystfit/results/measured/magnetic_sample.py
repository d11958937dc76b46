"""The sample of a magnetic measurement: volume, demagnetizing factor and image factor, from options or from the header of the file."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

import numpy as np

from hystfit.errors import DataError

_NUMBER = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")
# Properties in headers: name, and the factor to SI where the name states no unit (Quantum Design: mg, mm, mm3).
_MASS = re.compile(r"(?:sample[ _]?)?(?:mass|weight)\s*[\[(]?\s*(?P<unit>mg|g|kg)?\s*[\])]?", re.IGNORECASE)
_SIZE = re.compile(r"(?:sample[ _]?)?(?:size|dimensions)\s*[\[(]?\s*(?P<unit>mm|cm|m)?\s*[\])]?", re.IGNORECASE)
_VOLUME = re.compile(r"(?:sample[ _]?)?volume\s*[\[(]?\s*(?P<unit>mm3|cm3|m3)?\s*[\])]?", re.IGNORECASE)
_FACTORS = {"mg": 1e-6, "g": 1e-3, "kg": 1.0, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "mm3": 1e-9, "cm3": 1e-6, "m3": 1.0}
_QUANTUM_DESIGN = {"SAMPLE_MASS": "mg", "SAMPLE_SIZE": "mm", "SAMPLE_VOLUME": "mm3"}


@dataclasses.dataclass(frozen=True)
class Sample:
    """What is known of the sample, in SI units; None where unknown.

    Attributes:
        size: of a rectangular prism, three lengths [m]; the field is along the last.
        size_stderr: standard error of each length [m].
        volume: [m^3]; that of the prism by default, or the mass over the density.
        mass: [kg].
        density: [kg/m^3].
        demagnetization: factor N, from 0 (closed circuit) to 1; that of the prism by default.
        image: factor by which the moment is divided for the images of the sample in the poles of the magnet.

    Raises:
        DataError: a length, mass, density or factor that is not positive, or N outside 0 to 1.
    """

    size: tuple[float, float, float] | None = None
    size_stderr: float | None = None
    volume: float | None = None
    mass: float | None = None
    density: float | None = None
    demagnetization: float | None = None
    image: float | None = None

    def __post_init__(self) -> None:
        for name in ("size", "volume", "mass", "density", "image"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value).all() and np.all(np.asarray(value) > 0)):
                raise DataError(f"the {name} of the sample must be positive, got {value}")
        if self.size is not None and len(self.size) != 3:
            raise DataError(f"the size of the sample must be three lengths, got {len(self.size)}")
        if self.demagnetization is not None and not 0 <= self.demagnetization <= 1:
            raise DataError(f"a demagnetizing factor lies between 0 and 1, got {self.demagnetization}")

    @property
    def known_volume(self) -> tuple[float, str] | None:
        """Volume [m^3] and how it follows; None where unknown."""
        if self.volume is not None:
            return self.volume, "as stated"
        if self.size is not None:
            return float(np.prod(self.size)), f"of a prism of {_lengths(self.size)}"
        if self.mass is not None and self.density is not None:
            return self.mass / self.density, f"{1e6 * self.mass:.4g} mg at {1e-3 * self.density:.4g} g/cm3"
        return None

    @property
    def known_factor(self) -> tuple[float, str] | None:
        """Demagnetizing factor and how it follows; None where unknown."""
        if self.demagnetization is not None:
            return self.demagnetization, "as stated"
        if self.size is not None:
            return prism_factor(self.size), f"of a prism of {_lengths(self.size)} in a field along the last"
        return None

    def with_header(self, metadata: Mapping[str, str]) -> Sample:
        """The sample with what the header of the file states besides.

        Args:
            metadata: properties by their names in the file.
        """
        found: dict[str, object] = {}
        for key, text in metadata.items():
            numbers = [float(part) for part in _NUMBER.findall(text)]
            for name, pattern, count in (("mass", _MASS, 1), ("size", _SIZE, 3), ("volume", _VOLUME, 1)):
                match = pattern.fullmatch(key.strip())
                unit = _QUANTUM_DESIGN.get(key.strip()) or (match["unit"] if match else None)
                if match is None or unit is None or len(numbers) != count or min(numbers) <= 0:
                    continue
                values = tuple(_FACTORS[unit.lower()] * value for value in numbers)
                found[name] = values if count > 1 else values[0]
        known = {k: v for k, v in found.items() if getattr(self, k) is None}
        if self.volume is not None or (self.mass is not None and self.density is not None):
            known.pop("size", None)
        return dataclasses.replace(self, **known)  # type: ignore[arg-type]

    def longer(self, axis: int) -> Sample | None:
        """The sample with one length larger by its standard error; None without a size or an error."""
        if self.size is None or self.size_stderr is None:
            return None
        size = tuple(length + self.size_stderr * (k == axis) for k, length in enumerate(self.size))
        return dataclasses.replace(self, size=size)  # type: ignore[arg-type]


def _lengths(size: Sequence[float]) -> str:
    return " x ".join(f"{1e3 * length:.4g}" for length in size) + " mm"


def prism_factor(size: Sequence[float]) -> float:
    """Magnetometric demagnetizing factor of a rectangular prism along the last of its three lengths (Aharoni 1998, eq. 1)."""
    a, b, c = (float(length) for length in size)
    ab, bc, ca, abc = np.hypot(a, b), np.hypot(b, c), np.hypot(c, a), np.sqrt(a**2 + b**2 + c**2)
    log = lambda root, edge: np.log((root + edge) / (root - edge))
    value = (
        -(b**2 - c**2) / (2 * b * c) * log(abc, a)
        - (a**2 - c**2) / (2 * a * c) * log(abc, b)
        + b / (2 * c) * log(ab, a)
        + a / (2 * c) * log(ab, b)
        - c / (2 * a) * log(bc, b)
        - c / (2 * b) * log(ca, a)
        + 2 * np.arctan(a * b / (c * abc))
        + (a**3 + b**3 - 2 * c**3) / (3 * a * b * c)
        + (a**2 + b**2 - 2 * c**2) / (3 * a * b * c) * abc
        + c / (a * b) * (ca + bc)
        - (ab**3 + bc**3 + ca**3) / (3 * a * b * c)
    )
    return float(value / np.pi)
