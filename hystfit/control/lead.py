"""Leading a reference: the input with which a resonance follows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystfit.errors import DataError


def lead(reference: Any, dt: Any, *, omega: float, zeta: float) -> np.ndarray:
    """Input of y'' + 2 zeta omega y' + omega^2 y = omega^2 u for which y is the reference: u = r + 2 zeta r' / omega + r'' / omega^2.

    Derivatives are taken by five-point differences, so that the reference must be smooth over a few samples; its first and
    last two samples hold the nearest derivative.

    Args:
        reference: shape (T,), evenly sampled.
        dt: time between samples [s], a number or shape (T,).
        omega: natural frequency [rad/s].
        zeta: damping ratio.

    Raises:
        DataError: uneven sampling, fewer than five samples, or too few samples for the resonance.
    """
    r = np.asarray(reference, dtype=float)
    steps = np.asarray(dt, dtype=float)
    step = float(steps if steps.ndim == 0 else np.median(steps[1:]))
    if steps.ndim and not np.allclose(steps[1:], step, rtol=1e-6):
        raise DataError("the inverse of a resonance differentiates the reference: sample it at equal time steps")
    if r.size < 5 or not step > 0:
        raise DataError(
            f"the inverse of a resonance needs a reference of at least five samples and a positive time step, got {r.size} and {step:g} s"
        )
    if omega * step > 1.0:
        raise DataError(
            f"to invert a resonance of {omega:g} rad/s, the time step must be below {1 / omega:.2g} s, got {step:g} s: sample faster"
        )
    first, second = np.zeros_like(r), np.zeros_like(r)
    a, b, c, d, e = (r[k : r.size - 4 + k] for k in range(5))
    first[2:-2] = (a - 8 * b + 8 * d - e) / (12 * step)
    second[2:-2] = (-a + 16 * b - 30 * c + 16 * d - e) / (12 * step**2)
    for values in (first, second):
        values[:2], values[-2:] = values[2], values[-3]
    return r + 2 * zeta * first / omega + second / omega**2
