"""Adaptive feed-forward: the inverse of the model drives the plant, and the unscented filter updates the model."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from hystfit.control import InverseStep
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.identify.base import Sample, run_stream
from hystfit.identify.ukf import Ukf, UkfState
from hystfit.models.base import AbstractHysteresis, Resume, simulate
from hystfit.stage.actuator import Sensor
from hystfit.stage.stage import upsample


@dataclasses.dataclass(frozen=True)
class AdaptiveTracking:
    """A tracking run with a filter in parallel.

    Attributes:
        u: inputs, shape (T,).
        y: true outputs, shape (T,).
        error: reference minus true output, shape (T,).
        model: as identified at the end.
        state: of the filter at the end.
    """

    u: np.ndarray
    y: np.ndarray
    error: np.ndarray
    model: AbstractHysteresis
    state: UkfState


def track_adaptively(
    ukf: Ukf,
    plant: AbstractHysteresis,
    reference: Any,
    dt: float,
    *,
    block: int,
    limits: tuple[float, float],
    sensor: Sensor,
    seed: int,
    finer: int = 10,
) -> AdaptiveTracking:
    """Follow a reference in blocks: invert the present model, drive the plant, filter the measurement, update the model.

    The inverse starts each block from the state that the filter estimates, which includes hysteresis and creep that the
    earlier models missed.

    Args:
        ukf: filter that starts at the first model.
        plant: the true model; it starts at rest on zero input.
        reference: desired output, shape (T,).
        dt: sampling interval [s].
        block: samples between two updates of the inverse.
        limits: of the input.
        sensor: by which the filter measures the output.
        seed: of its noise.
        finer: integration steps of the plant per sample.

    Raises:
        DataError: a reference of the wrong shape, fewer samples than one block, dt or finer not positive.
    """
    reference = np.asarray(reference, dtype=float)
    if reference.ndim != 1 or not 1 <= block <= reference.size:
        raise DataError(f"the reference must have shape (T,) with T >= block = {block}, got {reference.shape}")
    if not 0 < dt < np.inf or finer < 1:
        raise DataError(f"dt and finer must be positive, got {dt} and {finer}")
    rng, state, zero = np.random.default_rng(seed), ukf.init(), jnp.zeros(())
    truth = Resume(plant.init(zero), zero)
    any_record = Record(u=np.zeros(2), y=np.zeros(2), t=np.array([0.0, dt]))
    memory, inputs, outputs = None, [], []
    for start in range(0, reference.size, block):
        desired = reference[start : start + block]
        inverse = InverseStep.of(ukf.model(np.asarray(state.mean[ukf.states :]), any_record), limits=limits)
        memory = inverse.init(0.0) if memory is None else Resume(state.mean[: ukf.states], memory.u)
        previous = memory.u
        memory, inverted = inverse.run(memory, jnp.asarray(desired), jnp.full(desired.size, dt))
        u = np.asarray(inverted.u)
        fine, steps = upsample(np.concatenate([[float(previous)], u]), np.full(u.size + 1, dt), finer)
        y, truth = simulate(plant, jnp.asarray(fine[1:]), jnp.asarray(steps[1:]), resume=truth)
        inputs.append(u)
        outputs.append(np.asarray(y)[finer - 1 :: finer])
        first = np.zeros(u.size, dtype=bool)
        first[0] = start == 0
        state, _ = run_stream(ukf, state, Sample.of(u, sensor.read(outputs[-1], rng), np.full(u.size, dt), first))
    y = np.concatenate(outputs)
    final = ukf.model(np.asarray(state.mean[ukf.states :]), any_record)
    return AdaptiveTracking(np.concatenate(inputs), y, reference - y, final, state)
