"""Loops: a plant driven by feed-forward, feedback or both, with the limits, delays and noise of a real one, in one scan."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import verb
from hystfit.control.feedback import AbstractController
from hystfit.control.online_inverse import AbstractRunningInverse, Limits
from hystfit.errors import DataError, ParameterError
from hystfit.models.shared.shapes import Scalar
from hystfit.models.shared.simulation import Resume


class Loop(eqx.Module):
    """A plant with its feed-forward and feedback, sample by sample.

    In sample k the controller uses r - y of sample k - 1, so that every loop has one sample of dead time, and the input is linear from
    u_(k-1) to u_k; the `delay` of the sensor is added to that.
    """

    # any model: hysteresis, creep or relaxation and resonance in a `Series`; or a stage of several inputs and outputs
    plant: Any
    controller: AbstractController | None  # of the feedback; None for none
    # computes the feed-forward sample by sample; None where it is given as an array
    inverse: AbstractRunningInverse | None
    low: Scalar  # low, high: limits of every input
    high: Scalar
    resolution: Float[Array, "..."]  # of the sensor, 0 for none, shape () or (k,)
    dt: Scalar  # time between samples [s]
    delay: int = eqx.field(static=True, default=0)  # of the sensor, in samples
    # the memory of the inverse follows the applied input, feedback included; else the one that it computed
    applied: bool = eqx.field(static=True, default=False)
    finer: int = eqx.field(static=True, default=1)  # integration steps of the plant per sample

    def move(self, state: Array, u0: Array, u1: Array) -> tuple[Array, Array]:
        """State and output of the plant after the input went from u0 to u1 in `finer` equal steps."""
        if self.finer == 1:
            return self.plant.step(state, u0, u1, self.dt)
        part, dt = (u1 - u0) / self.finer, self.dt / self.finer
        once = lambda state, k: self.plant.step(state, u0 + k * part, u0 + (k + 1) * part, dt)
        state, outputs = jax.lax.scan(once, state, jnp.arange(self.finer))
        return state, outputs[-1]


class _Carry(eqx.Module):
    plant: Array
    u: Array
    readings: Array
    controller: Array | None
    memory: Resume | None
    reference: Array


@eqx.filter_jit
def _run(loop: Loop, start: _Carry, samples: tuple[Array, Array, Array]) -> tuple[_Carry, tuple[Array, Array, Array]]:
    def body(carry: _Carry, sample: tuple[Array, Array, Array]) -> tuple[_Carry, tuple[Array, Array, Array]]:
        reference, ahead, noise = sample
        memory, controller = carry.memory, carry.controller
        if loop.inverse is not None:
            memory, answer = loop.inverse.step(carry.memory, reference, loop.dt)
            ahead = answer.u
        command = ahead
        error = carry.reference - carry.readings[-1]
        if loop.controller is not None:
            command = command + loop.controller.ask(carry.controller, error)
        u = jnp.clip(command, loop.low, loop.high)
        if loop.controller is not None:
            controller = loop.controller.step(carry.controller, error, u - command)
        if loop.inverse is not None and loop.applied:
            memory = loop.inverse.moved(carry.memory, u, loop.dt)
        state, y = loop.move(carry.plant, carry.u, u)
        read = y + noise
        fine = jnp.where(loop.resolution > 0, loop.resolution, 1.0)
        read = jnp.where(loop.resolution > 0, jnp.round(read / fine) * fine, read)
        readings = jnp.concatenate([read[None], carry.readings[:-1]])
        return _Carry(state, u, readings, controller, memory, reference), (u, y, ahead)

    return jax.lax.scan(body, start, samples)


@dataclasses.dataclass(frozen=True)
class LoopResult:
    """Result of a control loop.

    Attributes:
        t: times [s], shape (T,).
        reference, u, y, feedforward: of every sample, shape (T,), or (T, k) of a plant with k axes; y without sensor noise.
        saturated: how often an input was at a limit.
        notes: warnings.
    """

    t: np.ndarray
    reference: np.ndarray
    u: np.ndarray
    y: np.ndarray
    feedforward: np.ndarray
    saturated: int
    notes: tuple[str, ...]

    @property
    def error(self) -> np.ndarray:
        """Reference minus output, of their shape."""
        return self.reference - self.y

    def max_error(self, skip: float = 0.0) -> Any:
        """Largest |error| from the time `skip` [s] on; of each axis, shape (k,), where there are several."""
        return np.max(np.abs(self.error[self.t >= skip]), axis=0)

    def rms_error(self, skip: float = 0.0) -> Any:
        """RMS error from the time `skip` [s] on; of each axis, shape (k,), where there are several."""
        return np.sqrt(np.mean(self.error[self.t >= skip] ** 2, axis=0))


@verb
def run_loop(
    plant: Any,
    reference: Any,
    rate: float,
    *,
    feedforward: Any = None,
    controller: AbstractController | None = None,
    limits: Limits = (-np.inf, np.inf),
    noise: Any = 0.0,
    resolution: Any = 0.0,
    delay: int = 0,
    applied: bool = False,
    u0: Any = 0.0,
    seed: int = 0,
    finer: int = 1,
) -> LoopResult:
    """Run a loop over a reference.

    Args:
        plant: any model, or a `Stage` of three inputs and three axes, in equilibrium at u0 before.
        reference: desired output, shape (T,); (T, 3) of a stage.
        rate: samples per second.
        feedforward: input for every sample, of the reference's shape, such as `invert(...).u`; or an `InverseStep` (`StageInverse`) that
            computes it in the loop; None for none.
        controller: of the feedback, sampled at the same rate (`Decoupled` of a stage); None for none.
        limits: lowest and highest input.
        noise: standard deviation of the sensor's white noise, in output units; one number, or one for each axis.
        resolution: of the sensor, in output units; one number, or one for each axis.
        delay: of the sensor, in samples, in addition to the one sample of computing time.
        applied: the memory of a running inverse follows the applied input, feedback and limits included.
        u0: input before the first sample.
        seed: of the noise.
        finer: integration steps of the plant per sample; the input is linear between samples.

    Raises:
        DataError: shapes that do not fit, numbers out of range.
        ParameterError: the loop is unstable.
        PrecisionError: double precision is off.
    """
    wanted = np.asarray(reference, dtype=float)
    if wanted.ndim not in (1, 2) or wanted.size == 0 or not np.isfinite(wanted).all():
        raise DataError(
            f"the reference must be finite and of shape (T,) or (T, k) with T > 0, got shape {wanted.shape}"
        )
    sound = rate > 0 and delay >= 0 and finer >= 1 and limits[0] < limits[1]
    if not (sound and np.all(np.asarray(noise) >= 0) and np.all(np.asarray(resolution) >= 0)):
        raise DataError(
            "a loop needs rate > 0, delay, noise and resolution >= 0, finer >= 1 and low < high; "
            f"got {rate}, {delay}, {noise}, {resolution}, {finer}, {limits}"
        )
    inverse = feedforward if isinstance(feedforward, AbstractRunningInverse) else None
    given = None if inverse is not None else feedforward
    ahead = np.zeros_like(wanted) if given is None else np.asarray(given, dtype=float)
    if ahead.shape != wanted.shape:
        raise DataError(f"the feed-forward must have the shape of the reference {wanted.shape}, got {ahead.shape}")
    number = lambda value: jnp.asarray(value, dtype=jnp.result_type(float))
    numbers = (number(x) for x in (*limits, resolution, 1 / rate))
    loop = Loop(plant, controller, inverse, *numbers, delay=delay, applied=applied, finer=finer)
    start = _rest(loop, jnp.broadcast_to(number(u0), wanted.shape[1:]), number(wanted[0]))
    random = noise * np.random.default_rng(seed).standard_normal(wanted.shape)
    _, traces = _run(loop, start, (jnp.asarray(wanted), jnp.asarray(ahead), jnp.asarray(random)))
    u, y, ahead = map(np.asarray, traces)
    if not np.isfinite(y).all():
        raise ParameterError(
            f"the loop is unstable, and its output is not finite from {np.argwhere(~np.isfinite(y))[0, 0] / rate:.3g} s on: lower the "
            "gains, sample faster, or give limits"
        )
    saturated = int(np.count_nonzero((u <= limits[0]) | (u >= limits[1])))
    return LoopResult(np.arange(len(wanted)) / rate, wanted, u, y, ahead, saturated, _notes(u, saturated, limits))


@eqx.filter_jit
def _rest(loop: Loop, u0: Array, reference: Array) -> _Carry:
    state = loop.plant.init(u0)
    _, y = loop.plant.step(state, u0, u0, jnp.zeros(()))
    return _Carry(
        plant=state,
        u=u0,
        readings=jnp.broadcast_to(y, (loop.delay + 1, *y.shape)),
        controller=None if loop.controller is None else loop.controller.init(),
        memory=None if loop.inverse is None else loop.inverse.init(u0),
        reference=y + 0.0 * reference,  # before the first sample the reference is where the plant rests
    )


def _notes(u: np.ndarray, saturated: int, limits: Limits) -> tuple[str, ...]:
    notes = []
    if saturated > 0.01 * u.size:
        notes.append(f"the input is at a limit {limits} in {100 * saturated / u.size:.0f} % of the samples")
    jumps = np.count_nonzero(np.abs(np.diff(u, axis=0)) > 0.5 * (limits[1] - limits[0]))
    if jumps > 0.01 * u.size:
        notes.append("the input jumps from limit to limit: the loop is unstable, or its gain amplifies noise")
    return tuple(notes)
