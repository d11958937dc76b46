"""Adaptive feed-forward: the inverse of the model drives the plant, and the unscented filter corrects the model as it runs."""

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
from hystfit.stage.stage import refine


@dataclasses.dataclass(frozen=True)
class Adapted:
    """A tracking run with a filter beside it.

    Attributes:
        u: inputs given, shape (T,).
        y: true outputs, shape (T,).
        error: reference less true output, shape (T,).
        model: as identified at the end.
        state: of the filter, to go on from.
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
) -> Adapted:
    """Follow a reference in blocks: invert the present model, drive the plant, filter what the sensor says, take the new model.

    The inverse goes on from the filter's own estimate of the state, so that hysteresis and creep that the model missed before are
    in its memory.

    Args:
        ukf: started at the model to begin with.
        plant: model that plays the truth; it starts at rest on zero input.
        reference: wanted output, shape (T,).
        dt: sampling time.
        block: samples between two corrections of the inverse.
        limits: of the input.
        sensor: what the filter sees the output through.
        seed: of its noise.
        finer: integration steps of the plant a sample.

    Raises:
        DataError: a reference of the wrong shape, fewer samples than one block, a sampling time or a refinement that is not positive.
    """
    reference = np.asarray(reference, dtype=float)
    if reference.ndim != 1 or not 1 <= block <= reference.size:
        raise DataError(f"the reference must have shape (T,) with T >= block = {block}, got {reference.shape}")
    if not 0 < dt < np.inf or finer < 1:
        raise DataError(f"dt and finer must be positive, got {dt} and {finer}")
    rng, state, zero = np.random.default_rng(seed), ukf.init(), jnp.zeros(())
    truth = Resume(plant.init(zero), zero)
    name = Record(u=np.zeros(2), y=np.zeros(2), t=np.array([0.0, dt]))
    memory, given, reached = None, [], []
    for start in range(0, reference.size, block):
        wanted = reference[start : start + block]
        model = ukf.model(np.asarray(state.mean[ukf.states :]), name)
        assert model is not None
        inverse = InverseStep.of(model, limits=limits)
        memory = inverse.init(0.0) if memory is None else Resume(state.mean[: ukf.states], memory.u)
        begun = memory.u
        memory, answer = inverse.run(memory, jnp.asarray(wanted), jnp.full(wanted.size, dt))
        u = np.asarray(answer.u)
        fine, times = refine(np.concatenate([[float(begun)], u]), np.full(u.size + 1, dt), finer)
        y, truth = simulate(plant, jnp.asarray(fine[1:]), jnp.asarray(times[1:]), resume=truth)
        given.append(u)
        reached.append(np.asarray(y)[finer - 1 :: finer])
        first = np.zeros(u.size, dtype=bool)
        first[0] = start == 0
        state, _ = run_stream(ukf, state, Sample.of(u, sensor.read(reached[-1], rng), np.full(u.size, dt), first))
    y = np.concatenate(reached)
    final = ukf.model(np.asarray(state.mean[ukf.states :]), name)
    assert final is not None
    return Adapted(np.concatenate(given), y, reference - y, final, state)
