"""An inverse fed sample by sample: what a controller runs, and what `invert` runs over a whole reference."""

from __future__ import annotations

import abc
import enum
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from hystfit.config import require_x64
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar, Signal
from hystfit.models.shared.simulation import Resume, equilibrium
from hystfit.models.shared.step_inverse import AbstractStepInverse

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

Limits = tuple[float | int, float | int]


class Status(enum.IntEnum):
    """Status of one sample of a reference."""

    OK = 0
    SATURATED = 1
    NOT_MONOTONE = 2
    OUT_OF_RANGE = 3

    @property
    def label(self) -> str:
        """As printed: "not-monotone"."""
        return self.name.lower().replace("_", "-")


class Answer(NamedTuple):
    """One sample of an inverse: input, the model's output for it, and its `Status` as a number."""

    u: Scalar
    y: Scalar
    status: Int[Array, ""]


class AbstractRunningInverse(eqx.Module):
    """A feed-forward that a loop runs along: of one input, or of several at once (arrays of shape (k,))."""

    @abc.abstractmethod
    def init(self, u0: Any = 0.0) -> Resume:
        """The memory in equilibrium at an input."""

    @abc.abstractmethod
    def step(self, memory: Resume, target: Any, dt: Any = 0.0) -> tuple[Resume, Answer]:
        """The memory after one sample of the reference, and the input for it.

        Args:
            memory: state and last input.
            target: desired output.
            dt: time since the last sample [s].
        """

    @abc.abstractmethod
    def moved(self, memory: Resume, u: Array, dt: Any = 0.0) -> Resume:
        """The memory after an input that differs from the one computed.

        Args:
            memory: before the sample.
            u: input that was given.
            dt: time since the last sample [s].
        """


class InverseStep(AbstractRunningInverse):
    """An inverse fed sample by sample: `memory = init(u0)`, then `memory, answer = step(memory, target, dt)`.

    The memory is that of the model itself, updated with the input that is actually applied: a reference out of reach is followed as
    closely as the limits allow, and later samples are correct again. Make one with `InverseStep.of`.

    Attributes:
        model: what is inverted.
        solver: its one-sample inverse.
        low, high: limits of the input.
        tolerance: miss of the output up to which a sample is met.
        given: whether the user set the limits; else they are the range in which the model is known.
    """

    model: AbstractHysteresis
    solver: AbstractStepInverse
    low: Scalar
    high: Scalar
    tolerance: Scalar
    given: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls, model: AbstractHysteresis | FitResult, *, limits: Limits | None = None, tolerance: float | None = None
    ) -> InverseStep:
        """An inverse of a model, or of a fit.

        Args:
            model: any model without a delay or a resonance.
            limits: lowest and highest input; None for the range in which the model is known (of a fit: that of its data).
            tolerance: miss of the output up to which a sample is met; None for 1e-7 of what the model reaches.

        Raises:
            ModelError: a delay or a resonance; no limits where the inverse is a search and the model names no range.
        """
        require_x64()
        known, inverted = fitted_inputs(model)
        edges = limits if limits is not None else known
        low, high = (float(edge) for edge in edges) if edges is not None else (-np.inf, np.inf)
        if not low < high:
            raise ModelError(f"limits must be (low, high) with low < high, got {limits}")
        solver = inverted.step_inverse()
        bounded = bool(np.isfinite([low, high]).all())
        as_array = lambda value: jnp.asarray(value, dtype=jnp.result_type(float))
        travel = float(_output_travel(solver, as_array(low), as_array(high))) if bounded else 0.0
        if travel < 0:
            solver = inverted.step_inverse(-1.0)
        if solver.needs_limits and not bounded:
            raise ModelError(
                f"the inverse of {type(inverted).__name__} is a search: give limits=(low, high), the inputs to search between"
            )
        if tolerance is None:
            tolerance = 1e-7 * abs(travel) or 1e-9
        return cls(inverted, solver, *map(as_array, (low, high, tolerance)), given=limits is not None)

    def init(self, u0: Any = 0.0) -> Resume:
        """The model in equilibrium at an input."""
        u0 = jnp.asarray(u0, dtype=jnp.result_type(float))
        return Resume(equilibrium(self.model, u0), u0)

    def step(self, memory: Resume, target: Any, dt: Any = 0.0) -> tuple[Resume, Answer]:
        """The input for the next sample of the reference, `dt` after the last.

        A target that is not finite holds the input and is out of range.
        """
        state, u0 = memory
        target, dt = (jnp.asarray(value, dtype=u0.dtype) for value in (target, dt))
        known = jnp.isfinite(target)
        aim = jnp.where(known, target, 0.0)
        root = self.solver.solve(state, u0, aim, dt, self.low, self.high)
        wanted = jnp.where(known & ~jnp.isnan(root.x), root.x, u0)
        u = jnp.clip(wanted, self.low, self.high)
        u = jnp.where(jnp.isfinite(u), u, u0)
        state, y = self.solver.advance(state, u0, u, dt)
        missed = jnp.abs(y - aim) > self.tolerance
        edge = ((u == self.low) | (u == self.high)) & known
        status = jnp.where(root.rising, jnp.where(missed, Status.OUT_OF_RANGE, Status.OK), Status.NOT_MONOTONE)
        if self.given:
            status = jnp.where(missed & edge, Status.SATURATED, status)
        status = jnp.where(known, status, Status.OUT_OF_RANGE)
        return Resume(state, u), Answer(u, y, status)

    def moved(self, memory: Resume, u: Array, dt: Any = 0.0) -> Resume:
        dt = jnp.asarray(dt, dtype=memory.u.dtype)
        return Resume(self.solver.advance(memory.state, memory.u, u, dt)[0], u)

    def run(self, memory: Resume, targets: Signal, dt: Signal) -> tuple[Resume, Answer]:
        """All samples of a reference in one scan.

        Args:
            memory: state and last input before the first sample.
            targets: reference, shape (T,).
            dt: time between its samples, shape (T,) [s].
        """
        return _run(self, memory, targets, dt)


@eqx.filter_jit
def _run(inverse: InverseStep, memory: Resume, targets: Array, dt: Array) -> tuple[Resume, Answer]:
    return jax.lax.scan(lambda m, sample: inverse.step(m, *sample), memory, (targets, dt))


def fitted_inputs(model: Any) -> tuple[tuple[float, float] | None, AbstractHysteresis]:
    """The input range of a model (for a fit, the range of the fitted input), and the model."""
    if isinstance(model, AbstractHysteresis):
        return model.reach(), model
    return model.input_range, model.device


@eqx.filter_jit
def _output_travel(solver: AbstractStepInverse, low: Array, high: Array) -> Array:
    """Change of the output from the lower to the upper limit."""
    state, first = solver.advance(solver.model.init(low), low, low, jnp.zeros_like(low))
    return solver.advance(state, low, high, jnp.zeros_like(low))[1] - first
