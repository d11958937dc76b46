"""Adaptive feed-forward: the inverse of the model drives the plant, and the unscented filter updates the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.control import InverseStep
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.identify.base import Sample, run_stream
from hystfit.identify.ukf import Ukf, UkfState
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.simulation import Resume
from hystfit.stage.actuator import Sensor
from hystfit.stage.stage import upsample


@dataclasses.dataclass(frozen=True)
class AdaptiveTracking:
    """A tracking run with filters in parallel.

    Attributes:
        u: inputs, shape (T,), or (T, 3) of a stage.
        y: true outputs, of the same shape.
        error: reference minus true output, of the same shape.
        models: of each input, as identified at the end.
        states: of the filters at the end.
    """

    u: np.ndarray
    y: np.ndarray
    error: np.ndarray
    models: tuple[AbstractHysteresis, ...]
    states: tuple[UkfState, ...]


def track_adaptively(
    filters: Ukf | Sequence[Ukf],
    plant: Any,
    reference: Any,
    dt: float,
    *,
    block: int,
    limits: tuple[float, float],
    sensor: Sensor | Sequence[Sensor],
    seed: int,
    finer: int = 10,
    jacobian: Any = None,
) -> AdaptiveTracking:
    """Follow a reference in blocks: invert the present model, drive the plant, filter the measurement, update the model.

    The inverse starts each block from the state that the filter estimates, which includes hysteresis and creep that the
    earlier models missed. A stage has a filter for each actuator, which measures its extension by the probes of the platform
    and the inverse Jacobian.

    Args:
        filters: start at the first model; three of them for a stage.
        plant: the true model, or a `Stage`; it starts in equilibrium at zero input.
        reference: desired output, shape (T,), or poses of shape (T, 3) of a stage.
        dt: sampling interval [s].
        block: samples between two updates of the inverse.
        limits: of the input.
        sensor: by which the filter measures the output; of each axis for a stage.
        seed: of its noise.
        finer: integration steps of the plant per sample.
        jacobian: of a stage, pose from extensions, shape (3, 3).

    Raises:
        DataError: a reference of the wrong shape, fewer samples than one block, dt or finer not positive.
    """
    single = isinstance(filters, Ukf)
    each = (filters,) if isinstance(filters, Ukf) else tuple(filters)
    sensors = (sensor,) * len(each) if isinstance(sensor, Sensor) else tuple(sensor)
    reference = np.asarray(reference, dtype=float)
    if reference.shape[1:] != (() if single else (len(each),)) or not 1 <= block <= len(reference):
        shape = "(T,)" if single else f"(T, {len(each)})"
        raise DataError(f"the reference must have shape {shape} with T >= block = {block}, got {reference.shape}")
    if not 0 < dt < np.inf or finer < 1:
        raise DataError(f"dt and finer must be positive, got {dt} and {finer}")
    to_lengths = np.eye(len(each)) if jacobian is None else np.linalg.inv(np.asarray(jacobian, dtype=float)).T
    rng, channels = np.random.default_rng(seed), [_Channel(ukf, limits, dt) for ukf in each]
    before = np.zeros(reference.shape[1:])
    truth, inputs, outputs = plant.init(jnp.asarray(before)), [], []
    for start in range(0, len(reference), block):
        lengths = reference[start : start + block].reshape(-1, len(each)) @ to_lengths
        u = np.stack([c.invert(column) for c, column in zip(channels, lengths.T, strict=True)], axis=1)
        u = u[:, 0] if single else u
        fine, steps = upsample(np.concatenate([before[None], u]), np.full(len(u) + 1, dt), finer)
        truth, y = _drive(plant, truth, jnp.asarray(fine), jnp.asarray(steps[1:]))
        y, before = np.asarray(y)[finer - 1 :: finer], u[-1]
        read = np.stack([s.read(c, rng) for s, c in zip(sensors, y.reshape(len(y), -1).T, strict=True)], axis=1)
        for channel, column, length in zip(channels, u.reshape(len(u), -1).T, (read @ to_lengths).T, strict=True):
            channel.filter(column, length, first=start == 0)
        inputs.append(u)
        outputs.append(y)
    y = np.concatenate(outputs)
    models, states = tuple(c.model() for c in channels), tuple(c.state for c in channels)
    return AdaptiveTracking(np.concatenate(inputs), y, reference - y, models, states)


@eqx.filter_jit
def _drive(plant: Any, state: Array, u: Array, dt: Array) -> tuple[Array, Array]:
    """State and outputs of a plant; u begins with the input before, shape (T + 1, ...)."""
    return jax.lax.scan(lambda s, sample: plant.step(s, *sample), state, (u[:-1], u[1:], dt))


class _Channel:
    """One input: its filter, and the memory of its inverse between blocks."""

    def __init__(self, ukf: Ukf, limits: tuple[float, float], dt: float):
        self.ukf, self.limits, self.dt = ukf, limits, dt
        self.state = ukf.init()
        self.memory: Resume | None = None

    def model(self) -> AbstractHysteresis:
        """As identified so far."""
        z = np.asarray(self.state.mean[self.ukf.states :])
        return self.ukf.model(z, Record(u=np.zeros(2), y=np.zeros(2), t=np.array([0.0, self.dt])))

    def invert(self, desired: np.ndarray) -> np.ndarray:
        """Inputs for the next outputs, shape (T,)."""
        inverse = InverseStep.of(self.model(), limits=self.limits)
        start = inverse.init(0.0) if self.memory is None else Resume(self.state.mean[: self.ukf.states], self.memory.u)
        self.memory, answer = inverse.run(start, jnp.asarray(desired), jnp.full(desired.size, self.dt))
        return np.asarray(answer.u)

    def filter(self, u: np.ndarray, y: np.ndarray, *, first: bool) -> None:
        """Update the model by inputs and outputs, shape (T,); `first` where the run begins."""
        begins = np.zeros(u.size, dtype=bool)
        begins[0] = first
        self.state, _ = run_stream(self.ukf, self.state, Sample.of(u, y, np.full(u.size, self.dt), begins))
