"""Transfer functions of linear loops: poles, stability margins and root loci."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hystfit.errors import ParameterError


@dataclasses.dataclass(frozen=True)
class TransferFunction:
    """A rational function of s: numerator and denominator, highest power first.

    Raises:
        ParameterError: not finite, no denominator, or more zeros than poles.
    """

    num: tuple[float, ...]
    den: tuple[float, ...]

    def __post_init__(self) -> None:
        num, den = (tuple(float(c) for c in np.trim_zeros(np.atleast_1d(part), "f")) for part in (self.num, self.den))
        if not den or not np.isfinite([*num, *den]).all():
            raise ParameterError(
                f"a transfer function needs a finite numerator and denominator, got {self.num} / {self.den}"
            )
        if len(num) > len(den):
            raise ParameterError(
                f"a transfer function needs at least as many poles as zeros, got {self.num} / {self.den}"
            )
        object.__setattr__(self, "num", num or (0.0,))
        object.__setattr__(self, "den", den)

    def __mul__(self, other: TransferFunction | float) -> TransferFunction:
        if not isinstance(other, TransferFunction):
            return TransferFunction(tuple(float(other) * np.asarray(self.num)), self.den)
        return TransferFunction(tuple(np.polymul(self.num, other.num)), tuple(np.polymul(self.den, other.den)))

    def __call__(self, s: Any) -> np.ndarray:
        """Value at complex s, any shape."""
        return np.asarray(np.polyval(self.num, s) / np.polyval(self.den, s))

    @property
    def zeros(self) -> np.ndarray:
        """Zeros [rad/s]."""
        return np.roots(self.num)

    @property
    def poles(self) -> np.ndarray:
        """Poles [rad/s]."""
        return np.roots(self.den)

    def closed(self) -> np.ndarray:
        """Poles of the loop closed by unit negative feedback, slowest first."""
        poles = np.roots(np.polyadd(self.den, self.num))
        return poles[np.argsort(np.abs(poles))]


def second_order(omega: float, zeta: float, gain: float = 1.0) -> TransferFunction:
    """gain omega^2 / (s^2 + 2 zeta omega s + omega^2).

    Args:
        omega: natural frequency [rad/s].
        zeta: damping ratio.
        gain: static gain.
    """
    return TransferFunction((gain * omega**2,), (1.0, 2 * zeta * omega, omega**2))


def damping(poles: np.ndarray) -> float:
    """Least damping ratio -Re p / |p| of any pole; negative where one is unstable."""
    return float(np.min(-np.real(poles) / np.abs(poles)))


def root_locus(loop: TransferFunction, gains: Any) -> np.ndarray:
    """Closed-loop poles for every gain that multiplies the loop, shape (gains, poles)."""
    return np.stack([(loop * float(k)).closed() for k in np.atleast_1d(gains)])


@dataclasses.dataclass(frozen=True)
class Margins:
    """Stability margins of a loop.

    Attributes:
        phase: at the crossover that has the least [deg]; None where the loop's gain never passes one.
        crossover: that frequency [rad/s]; None where the loop's gain never passes one.
        gain: factor by which the gain may grow; infinite where the phase never reaches -180 degrees.
        sensitivity: largest |1 / (1 + L)|.
        stable: by the encirclements of -1.
    """

    phase: float | None
    crossover: float | None
    gain: float
    sensitivity: float
    stable: bool


def margins(loop: TransferFunction, delay: float = 0.0) -> Margins:
    """Margins of a loop with a dead time `delay` [s], unit negative feedback.

    Evaluated on a grid of frequencies from 1e-3 of the slowest corner to 1e3 of the fastest, dense enough for resonances of
    a damping ratio of 1e-3 and more.
    """
    corners = np.abs(np.concatenate([loop.poles, loop.zeros]))
    corners = corners[corners > 0]
    low, high = (1e-3 * corners.min(), 1e3 * corners.max()) if corners.size else (1e-3, 1e3)
    w = np.unique(
        np.concatenate([np.geomspace(low, high, 20_000), *(c * np.linspace(0.9, 1.1, 2001) for c in corners)])
    )
    value = loop(1j * w) * np.exp(-1j * w * delay)
    size, angle = np.abs(value), np.unwrap(np.angle(value))
    passes = np.flatnonzero((size[1:] < 1) != (size[:-1] < 1))
    part = (np.log(size[passes])) / (np.log(size[passes]) - np.log(size[passes + 1]))
    at = angle[passes] + part * (angle[passes + 1] - angle[passes])
    spare = np.degrees((at + np.pi + np.pi) % (2 * np.pi) - np.pi)
    least = int(np.argmin(np.abs(spare))) if passes.size else None
    turned = (angle - np.pi) / (2 * np.pi)  # crosses a whole number at -180 degrees
    crosses = np.flatnonzero(np.floor(turned[1:]) != np.floor(turned[:-1]))
    share = (np.round(turned[crosses]) - turned[crosses]) / (turned[crosses + 1] - turned[crosses])
    there = np.exp((1 - share) * np.log(size[crosses]) + share * np.log(size[crosses + 1]))
    gain = float(1 / there.max()) if crosses.size else np.inf
    around = np.unwrap(np.angle(1 + value))
    encircled = round(2 * (around[-1] - around[0]) / (2 * np.pi))  # of the whole imaginary axis, counter-clockwise
    unstable = int(np.count_nonzero(np.real(loop.poles) > 0))
    return Margins(
        None if least is None else float(spare[least]),
        None if least is None else float(w[passes[least]] + part[least] * (w[passes[least] + 1] - w[passes[least]])),
        gain,
        float(np.max(1 / np.abs(1 + value))),
        bool(encircled == unstable),
    )
