"""Loops: a plant driven by feed-forward, feedback or both, with the limits, delays and noise of a real one, in one scan."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_x64
from hystfit.control.feedback import Controller
from hystfit.control.online_inverse import InverseStep, Limits
from hystfit.errors import DataError, ParameterError
from hystfit.models.base import AbstractHysteresis, Resume


class Loop(eqx.Module):
    """A plant and what drives it, sample by sample.

    In sample k the controller takes r - y of sample k - 1, so that one sample of dead time belongs to every loop, and the input goes in a
    straight line from u_(k-1) to u_k; `delay` samples of the sensor come on top.

    Attributes:
        plant: any model: hysteresis, creep or relaxation and resonance in a `Series`.
        controller: of the feedback; None for none.
        inverse: of the feed-forward run along; None where the feed-forward is given as an array.
        low, high: between which the input is held.
        resolution: of the sensor, 0 for none.
        dt: time between samples [s].
        delay: of the sensor, in samples.
        applied: the inverse remembers the input that was given, feedback included; else what it asked for itself.
    """

    plant: AbstractHysteresis
    controller: Controller | None
    inverse: InverseStep | None
    low: Float[Array, ""]
    high: Float[Array, ""]
    resolution: Float[Array, ""]
    dt: Float[Array, ""]
    delay: int = eqx.field(static=True, default=0)
    applied: bool = eqx.field(static=True, default=False)


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
        memory = carry.memory
        if loop.inverse is not None and carry.memory is not None:
            memory, answer = loop.inverse.step(carry.memory, reference, loop.dt)
            ahead = answer.u
        asked = ahead
        error = carry.reference - carry.readings[-1]
        if loop.controller is not None and carry.controller is not None:
            asked = asked + loop.controller.ask(carry.controller, error)
        u = jnp.clip(asked, loop.low, loop.high)
        controller = None
        if loop.controller is not None and carry.controller is not None:
            controller = loop.controller.step(carry.controller, error, u - asked)
        if loop.inverse is not None and carry.memory is not None and loop.applied:
            old = carry.memory
            memory = Resume(loop.inverse.solver.advance(old.state, old.u, u, loop.dt)[0], u)
        state, y = loop.plant.step(carry.plant, carry.u, u, loop.dt)
        read = y + noise
        fine = jnp.where(loop.resolution > 0, loop.resolution, 1.0)
        read = jnp.where(loop.resolution > 0, jnp.round(read / fine) * fine, read)
        readings = jnp.concatenate([read[None], carry.readings[:-1]])
        return _Carry(state, u, readings, controller, memory, reference), (u, y, ahead)

    return jax.lax.scan(body, start, samples)


@dataclasses.dataclass(frozen=True)
class LoopResult:
    """What a loop did.

    Attributes:
        t, reference, u, y, feedforward: of every sample, shape (T,); y without sensor noise.
        saturated: samples in which the input was at a limit.
        notes: what to mind.
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
        """Reference less output, shape (T,)."""
        return self.reference - self.y

    def max_error(self, skip: float = 0.0) -> float:
        """Largest |error| from the time `skip` [s] on."""
        return float(np.max(np.abs(self.error[self.t >= skip])))

    def rms_error(self, skip: float = 0.0) -> float:
        """RMS error from the time `skip` [s] on."""
        return float(np.sqrt(np.mean(self.error[self.t >= skip] ** 2)))


def run_loop(
    plant: AbstractHysteresis,
    reference: Any,
    rate: float,
    *,
    feedforward: Any = None,
    controller: Controller | None = None,
    limits: Limits = (-np.inf, np.inf),
    noise: float = 0.0,
    resolution: float = 0.0,
    delay: int = 0,
    applied: bool = False,
    u0: float = 0.0,
    seed: int = 0,
) -> LoopResult:
    """Run a loop over a reference.

    Args:
        plant: any model, at rest on u0 before.
        reference: wanted output, shape (T,).
        rate: samples per second.
        feedforward: input for every sample, shape (T,), such as `invert(...).u`; or an `InverseStep` to run along; None for none.
        controller: of the feedback, sampled at the same rate; None for none.
        limits: lowest and highest input.
        noise: standard deviation of the sensor's white noise, in output units.
        resolution: of the sensor, in output units.
        delay: of the sensor, in samples, beside the one sample that computing takes.
        applied: let a running inverse remember the input that was given, feedback and limits included.
        u0: input before the first sample.
        seed: of the noise.

    Raises:
        DataError: shapes that do not fit, numbers out of range.
        ParameterError: the loop ran away.
        PrecisionError: double precision is off.
    """
    require_x64()
    wanted = np.asarray(reference, dtype=float)
    if wanted.ndim != 1 or wanted.size == 0 or not np.isfinite(wanted).all():
        raise DataError(f"the reference must be finite and of shape (T,) with T > 0, got shape {wanted.shape}")
    if not (rate > 0 and delay >= 0 and noise >= 0 and resolution >= 0 and limits[0] < limits[1]):
        raise DataError(
            f"a loop needs rate > 0, delay, noise and resolution >= 0 and low < high; got {rate}, {delay}, {noise}, {resolution}, {limits}"
        )
    inverse = feedforward if isinstance(feedforward, InverseStep) else None
    ahead = (
        np.zeros_like(wanted) if feedforward is None or inverse is not None else np.asarray(feedforward, dtype=float)
    )
    if ahead.shape != wanted.shape:
        raise DataError(f"the feed-forward must have the shape of the reference {wanted.shape}, got {ahead.shape}")
    number = lambda value: jnp.asarray(value, dtype=jnp.result_type(float))
    loop = Loop(
        plant, controller, inverse, *(number(x) for x in (*limits, resolution, 1 / rate)), delay=delay, applied=applied
    )
    start = _rest(loop, number(u0), number(wanted[0]))
    random = noise * np.random.default_rng(seed).standard_normal(wanted.size) if noise else np.zeros(wanted.size)
    _, (u, y, given) = _run(loop, start, (jnp.asarray(wanted), jnp.asarray(ahead), jnp.asarray(random)))
    u, y, given = (np.asarray(value) for value in (u, y, given))
    if not np.isfinite(y).all():
        raise ParameterError(
            f"the loop ran away at {np.argmax(~np.isfinite(y)) / rate:.3g} s: lower the gains, sample faster, or give limits"
        )
    saturated = int(np.count_nonzero((u <= limits[0]) | (u >= limits[1])))
    return LoopResult(np.arange(wanted.size) / rate, wanted, u, y, given, saturated, _notes(u, saturated, limits))


def _rest(loop: Loop, u0: Array, reference: Array) -> _Carry:
    state = loop.plant.init(u0)
    _, y = loop.plant.step(state, u0, u0, jnp.zeros_like(u0))
    return _Carry(
        plant=state,
        u=u0,
        readings=jnp.full((loop.delay + 1,), y),
        controller=None if loop.controller is None else loop.controller.init(),
        memory=None if loop.inverse is None else loop.inverse.init(u0),
        reference=y + 0.0 * reference,  # before the first sample the reference is where the plant rests
    )


def _notes(u: np.ndarray, saturated: int, limits: Limits) -> tuple[str, ...]:
    notes = []
    if saturated > 0.01 * u.size:
        notes.append(f"the input is at a limit {limits} in {100 * saturated / u.size:.0f} % of the samples")
    jumps = np.count_nonzero(np.abs(np.diff(u)) > 0.5 * (limits[1] - limits[0]))
    if jumps > 0.01 * u.size:
        notes.append("the input jumps from limit to limit: the loop is unstable, or its gain amplifies noise")
    return tuple(notes)
