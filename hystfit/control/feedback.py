"""Feedback: PD cascaded with lead-lag, designed from goals, run at a rate (Song et al. 2005, section on the controller)."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq
from scipy.signal import cont2discrete, tf2ss

from hystfit.config import require_x64
from hystfit.control.transfer import Margins, TransferFunction, damping, margins, second_order
from hystfit.errors import ParameterError
from hystfit.models.shared.shapes import Scalar


def pd_lead_lag(gain: float, *, derivative: float, filter: float, zero: float, pole: float) -> TransferFunction:
    """gain (T_d s + 1) / (T_f s + 1) (s / zero + 1) / (s / pole + 1).

    Args:
        gain: at s = 0, input over output units.
        derivative, filter: T_d of the PD part, and T_f of its roll-off [s].
        zero, pole: of the lead-lag part [rad/s]; a lag has its pole below its zero.

    Raises:
        ParameterError: a number that is not positive.
    """
    if not min(filter, zero, pole) > 0 or derivative < 0:
        raise ParameterError(
            f"time constants and corners must be positive, got derivative {derivative}, filter {filter}, zero {zero}, pole {pole}"
        )
    pd = TransferFunction((derivative, 1.0), (filter, 1.0))
    return pd * TransferFunction((1 / zero, 1.0), (1 / pole, 1.0)) * float(gain)


@dataclasses.dataclass(frozen=True)
class Design:
    """A controller, its design values, and the plant for which it was designed.

    Attributes:
        controller: as a transfer function, input over output units.
        poles: of the closed loop, slowest first, without sampling.
        damping: the least of the oscillating poles.
        static_error: of a constant reference, in parts.
        margins: with the dead time of sampling; `ideal` without.
        rate: samples per second; None where the loop is continuous.
        notes: warnings.
    """

    controller: TransferFunction
    poles: np.ndarray
    damping: float
    static_error: float
    margins: Margins
    ideal: Margins
    rate: float | None
    notes: tuple[str, ...]


def design(
    *,
    omega: float,
    zeta: float,
    gain: float,
    damping_ratio: float = 0.5,
    static_error: float = 1 / 16,
    lag: float = 3.0,
    zero: float = 20.0,
    filter: float | None = None,
    locus: bool = False,
    rate: float | None = None,
    delay: float = 1.5,
) -> Design:
    """PD with lag for a resonant plant, from a damping ratio and a static error.

    The static error fixes the loop's gain at rest, L0 = 1 / error - 1; the lag divides it by `lag` above its corners, which leaves
    L at the resonance, so that the loop closes at omega sqrt(1 + L); T_d then gives the damping ratio there. That rule leaves out the
    lag and the filter: with `locus` T_d is moved along the root locus until the oscillating poles have the ratio exactly.

    Args:
        omega, zeta: of the plant [rad/s, 1].
        gain: of the plant at rest, output over input.
        damping_ratio: desired for the closed loop.
        static_error: desired for a constant reference, as a fraction of it.
        lag: ratio of zero to pole of the lag.
        zero: of the lag [rad/s].
        filter: T_f of the PD part [s]; None for a tenth of the time 1 / omega of the closed loop.
        locus: search T_d on the locus.
        rate: samples per second, for the margins.
        delay: dead time of the sampled loop, in samples (one to compute, a half to hold).

    Raises:
        ParameterError: goals out of range, that no T_d on the locus reaches, or that leave the loop unstable.
    """
    if not (0 < damping_ratio < 1 and 0 < static_error < 1 and lag >= 1 and omega > 0 and gain != 0):
        raise ParameterError(
            "design needs 0 < damping_ratio < 1, 0 < static_error < 1, lag >= 1, omega > 0 and a gain that is not zero; got "
            f"{damping_ratio}, {static_error}, {lag}, {omega}, {gain}"
        )
    rest = 1 / static_error - 1
    fast = rest / lag
    closing = omega * np.sqrt(1 + fast)
    tf = 0.1 / closing if filter is None else float(filter)
    plant = second_order(omega, zeta, gain)
    make = lambda td: pd_lead_lag(rest / gain, derivative=td, filter=tf, zero=zero, pole=zero / lag)
    td = max(2 * damping_ratio * closing - 2 * zeta * omega, 0.0) / (fast * omega**2)
    if locus:
        miss = lambda td: _oscillating((make(td) * plant).closed()) - damping_ratio
        grid = td * np.geomspace(0.3, 3.0, 60)
        values = np.array([miss(value) for value in grid])
        turns = np.flatnonzero((values[1:] >= 0) != (values[:-1] >= 0))
        if not turns.size:
            raise ParameterError(
                f"no derivative time gives a damping ratio of {damping_ratio}: the largest on the root locus is "
                f"{values.max() + damping_ratio:.2f}; choose a smaller ratio, a larger static error or a faster filter"
            )
        found: Any = brentq(miss, grid[turns[0]], grid[turns[0] + 1])
        td = float(found)
    return assess(make(td), plant, rate=rate, delay=delay)


def assess(
    controller: TransferFunction, plant: TransferFunction, *, rate: float | None = None, delay: float = 1.5
) -> Design:
    """Analyze the closed loop of a controller and a plant; refuse an unstable one.

    Args:
        controller, plant: of the loop.
        rate: samples per second; None for a continuous loop.
        delay: dead time of the sampled loop, in samples.

    Raises:
        ParameterError: the loop is unstable, or the rate is too low for it; a rate that is not positive, a negative delay.
    """
    if (rate is not None and not rate > 0) or not delay >= 0:
        raise ParameterError(f"the rate must be positive and the delay not negative, got {rate} and {delay}")
    loop = controller * plant
    ideal = margins(loop)
    poles = loop.closed()
    if not ideal.stable or np.real(poles).max() >= 0:
        raise ParameterError(
            f"these gains make the closed loop unstable (poles {np.array2string(poles, precision=3)} rad/s): lower the gain or raise the "
            "derivative time"
        )
    sampled = margins(loop, delay / rate) if rate else ideal
    where = f"at {rate:g} samples/s with {delay:g} samples of delay" if rate else "without sampling"
    spare = "no crossover" if sampled.phase is None else f"a phase margin of {sampled.phase:.0f} deg"
    if not sampled.stable:
        wanted = ideal.phase or 0.0
        raise ParameterError(
            f"the loop is unstable {where}; it has {wanted:.0f} deg without sampling, of which the delay takes "
            f"{np.degrees((ideal.crossover or 0.0) * delay / (rate or 1.0)):.0f}: sample faster or lower the gain"
        )
    notes = [f"{spare} {where}, largest sensitivity {sampled.sensitivity:.2f}"]
    if sampled.phase is not None and sampled.phase < 30:
        notes.append(f"{spare} is small: the rate is too low for this loop, or its gain too high")
    static = 1 / abs(1 + loop(0.0))
    return Design(controller, poles, _oscillating(poles), float(static), sampled, ideal, rate, tuple(notes))


def _oscillating(poles: np.ndarray) -> float:
    pairs = poles[np.abs(np.imag(poles)) > 1e-6 * np.abs(poles)]
    return damping(pairs) if pairs.size else damping(poles)


class AbstractController(eqx.Module):
    """A feedback that a loop runs: of one error, or of several at once (arrays of shape (k,))."""

    @abc.abstractmethod
    def init(self) -> Array:
        """State at rest."""

    @abc.abstractmethod
    def ask(self, state: Array, error: Array) -> Array:
        """Output of the controller for an error."""

    @abc.abstractmethod
    def step(self, state: Array, error: Array, taken: Any = 0.0) -> Array:
        """Next state of the controller.

        Args:
            state: before the sample.
            error: reference minus output [y].
            taken: applied minus computed input, nonzero at the limits [u].
        """


class Controller(AbstractController):
    """A linear controller at a rate, with anti-windup:  x' = A x + B e + L (applied - command),  command = C x + D e.

    Tustin's rule (a trapezoid for every integral). L = B / D gives the state that belongs to the applied
    input instead of the computed one (Hanus et al. 1987); it needs D, and stable zeros.

    Attributes:
        A, B, C, D: of the sampled controller, shapes (n, n), (n,), (n,), ().
        L: gain of the anti-windup, shape (n,), zero for none.
    """

    A: Float[Array, "n n"]
    B: Float[Array, " n"]
    C: Float[Array, " n"]
    D: Scalar
    L: Float[Array, " n"]

    @classmethod
    def of(cls, transfer: TransferFunction, rate: float, *, anti_windup: bool = True) -> Controller:
        """Sample a continuous controller.

        Args:
            transfer: of the controller.
            rate: samples per second.
            anti_windup: feed back the part of the input that the limits cut off.

        Raises:
            ParameterError: the rate is not positive, or too low for the controller's poles.
        """
        require_x64()
        if not rate > 0:
            raise ParameterError(f"the rate must be positive, got {rate}")
        fastest = float(np.max(np.abs(transfer.poles), initial=0.0))
        if fastest > 2 * rate:
            raise ParameterError(
                f"the controller's pole at {fastest:.3g} rad/s needs more than {fastest / 2:.3g} samples/s, got {rate:g}"
            )
        a, b, c, d = _tustin(transfer, 1 / rate)
        gain = b / d if anti_windup and d else np.zeros(a.shape[0])
        if gain.size and np.max(np.abs(np.linalg.eigvals(a - np.outer(gain, c)))) >= 1:
            gain = np.zeros(a.shape[0])
        values = (a, b, c, d, gain)
        return cls(*(jnp.asarray(value, dtype=jnp.result_type(float)) for value in values))

    def init(self) -> Float[Array, " n"]:
        return jnp.zeros_like(self.B)

    def ask(self, state: Float[Array, " n"], error: Scalar) -> Scalar:
        return self.C @ state + self.D * error

    def step(self, state: Float[Array, " n"], error: Scalar, taken: Any = 0.0) -> Float[Array, " n"]:
        return self.A @ state + self.B * error + self.L * taken


def _tustin(transfer: TransferFunction, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """A, B, C, D of a transfer function sampled by the trapezoidal rule."""
    if len(transfer.den) == 1:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0), transfer.num[0] / transfer.den[0]
    sampled: Any = cont2discrete(tf2ss(transfer.num, transfer.den), step, "bilinear")
    a, b, c, d, _ = sampled
    return a, b[:, 0], c[0], float(d[0, 0])
