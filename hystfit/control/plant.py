"""The linear part of a plant from a step or a sweep: a resonance with gain and offset."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from hystfit.control.transfer import TransferFunction, second_order
from hystfit.errors import DataError
from hystfit.models.dynamics import SecondOrder

_FINEST = 8  # samples in a period of the resonance that an identification needs


@dataclasses.dataclass(frozen=True)
class LinearPlant:
    """An identified resonance:  y = offset + gain G(s) (u - u_0),  G(0) = 1.

    Attributes:
        omega, zeta, gain, offset: natural frequency [rad/s], damping ratio, output over input at rest, output before.
        stderr: of (omega, zeta, gain, offset), for independent noise; None for total least squares.
        rmse: of the free run over the record, in output units.
        nrmse_percent: the same in percent of the output's range.
        method: "output-error" or "total-least-squares".
    """

    omega: float
    zeta: float
    gain: float
    offset: float
    stderr: tuple[float, float, float, float] | None
    rmse: float
    nrmse_percent: float
    method: str

    @property
    def transfer(self) -> TransferFunction:
        """Gain and resonance."""
        return second_order(self.omega, self.zeta, self.gain)

    @property
    def model(self) -> SecondOrder:
        """The resonance alone, to follow a hysteresis in a `Series`."""
        return SecondOrder(omega=jnp.asarray(self.omega), zeta=jnp.asarray(self.zeta))


def identify_plant(u: Any, y: Any, dt: float, *, method: str = "output-error") -> LinearPlant:
    """A second-order plant from a record of a step or a sweep around one working point.

    "total-least-squares" (as Song et al. 2005) solves the difference equation with errors in all its columns, at the decimation with
    the smallest simulation error; its result is the start of "output-error", which fits the simulated output and is not biased by noise.

    Args:
        u, y: input and output, shape (T,), evenly sampled; at rest before.
        dt: time between samples [s].
        method: "output-error" or "total-least-squares".

    Raises:
        DataError: shapes, a constant input, no resonance found, or a rate too low for it.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    if u.shape != y.shape or u.ndim != 1 or u.size < 20 or not dt > 0:
        raise DataError(f"u and y need one shape (T,), T >= 20, and dt > 0; got {u.shape}, {y.shape}, {dt}")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise DataError("u and y must be finite: interpolate or cut out missing samples")
    if np.ptp(u) == 0 or np.ptp(y) == 0:
        raise DataError("input and output must not be constant: record a step or a sweep")
    if method not in ("output-error", "total-least-squares"):
        raise DataError(f"method must be output-error or total-least-squares, got {method!r}")
    place = _total_least_squares(u, y, dt)
    errors = None
    if method == "output-error":
        place, errors = _output_error(u, y, dt, place)
    omega, zeta = place
    if 2 * np.pi / (omega * dt) < _FINEST:
        raise DataError(
            f"the resonance found, {omega:.4g} rad/s, has {2 * np.pi / (omega * dt):.1f} samples in a period: sample faster"
        )
    gain, offset, residual = _linear_part(u, y, dt, omega, zeta)
    rmse = float(np.sqrt(np.mean(residual**2)))
    return LinearPlant(omega, zeta, gain, offset, errors, rmse, 100 * rmse / float(np.ptp(y)), method)


def _response(u: np.ndarray, dt: float, omega: float, zeta: float) -> np.ndarray:
    """Free run with gain one from rest, for inputs linear between samples."""
    model = second_order(omega, zeta)
    sampled: Any = cont2discrete((model.num, model.den), dt, method="foh")
    return np.asarray(lfilter(np.ravel(sampled[0]), sampled[1], u - u[0]))


def _linear_part(u: np.ndarray, y: np.ndarray, dt: float, omega: float, zeta: float) -> tuple[float, float, np.ndarray]:
    columns = np.column_stack([_response(u, dt, omega, zeta), np.ones(u.size)])
    (gain, offset), *_ = np.linalg.lstsq(columns, y, rcond=None)
    return float(gain), float(offset), y - columns @ np.array([gain, offset])


def _total_least_squares(u: np.ndarray, y: np.ndarray, dt: float) -> tuple[float, float]:
    """(omega, zeta) from the smallest singular vector, at the decimation of least free-run error."""
    best: tuple[float, tuple[float, float]] | None = None
    a, b = (y - y.mean()) / np.std(y), (u - u.mean()) / np.std(u)
    every = 1
    while u.size // every >= 20:
        columns = [a[2 * every - k * every : a.size - k * every] for k in range(3)]
        columns += [b[2 * every - k * every : b.size - k * every] for k in range(3)]
        theta = np.linalg.svd(np.column_stack([*columns, np.ones(columns[0].size)]), full_matrices=False)[2][-1]
        poles = np.roots(theta[:3]) if abs(theta[0]) > 1e-12 else np.zeros(0)
        if poles.size == 2 and abs(poles[0].imag) > 0 and 0 < abs(poles[0]) < 1:
            s = np.log(poles[0]) / (every * dt)
            place = (float(abs(s)), float(-s.real / abs(s)))
            cost = float(np.sum(_linear_part(u, y, dt, *place)[2] ** 2))
            if best is None or cost < best[0]:
                best = cost, place
        every *= 2
    if best is None:
        raise DataError(
            "no resonance found in this record: excite it with a step or a sweep through it, longer than its decay"
        )
    return best[1]


def _output_error(
    u: np.ndarray, y: np.ndarray, dt: float, start: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float, float, float]]:
    """(omega, zeta) of the least free-run error, and standard errors of omega, zeta, gain and offset."""
    free = lambda z: _linear_part(u, y, dt, *np.exp(z))[2]
    # Zeta above one would be no resonance; the lower bound keeps the filter stable.
    highest = np.log([np.pi / dt, 0.999])
    z0 = np.minimum(np.log(start), highest - 1e-6)
    found = least_squares(free, z0, bounds=([-np.inf, np.log(1e-5)], highest), x_scale=[0.1, 1.0])
    omega, zeta = (float(value) for value in np.exp(found.x))
    gain, offset, residual = _linear_part(u, y, dt, omega, zeta)
    full = lambda x: x[3] + x[2] * _response(u, dt, x[0], x[1])
    x = np.array([omega, zeta, gain, offset])
    steps = np.maximum(1e-6 * np.abs(x), 1e-9)
    jacobian = np.column_stack([(full(x + h) - full(x - h)) / (2 * h.max()) for h in np.diag(steps)])
    variance = float(residual @ residual) / max(y.size - 4, 1)
    scale = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale)) * variance / np.outer(scale, scale)
    sizes = np.sqrt(np.diag(covariance))
    return (omega, zeta), (float(sizes[0]), float(sizes[1]), float(sizes[2]), float(sizes[3]))
