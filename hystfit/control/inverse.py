"""The inverse of a model: the input that makes it follow a reference, with a status for every sample."""

from __future__ import annotations

import dataclasses
import enum
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.config import require_x64
from hystfit.control.bracketed import solve_rising
from hystfit.control.choose import reach, step_inverse
from hystfit.control.lead import lead
from hystfit.control.step_inverse import AbstractStepInverse
from hystfit.errors import DataError, ModelError
from hystfit.models.base import AbstractHysteresis, Resume
from hystfit.models.compose import Series
from hystfit.models.dynamics import SecondOrder

if TYPE_CHECKING:
    from hystfit.results import FitResult

Limits = tuple[float | int, float | int]
_WIDER = 0.05  # a fitted model is searched this part of its range beyond the inputs it was fitted on


class Status(enum.IntEnum):
    """What became of one sample of a reference."""

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

    u: Float[Array, ""]
    y: Float[Array, ""]
    status: Int[Array, ""]


class InverseStep(eqx.Module):
    """An inverse fed sample by sample: `memory = init(u0)`, then `memory, answer = step(memory, target, dt)`.

    The memory is that of the model itself, moved by the input that is really given: a reference out of reach is met as well as
    the limits allow, and what follows is right again. Make one with `InverseStep.of`.

    Attributes:
        model: what is inverted.
        solver: its one-sample inverse.
        low, high: between which the input is held.
        tolerance: miss of the output up to which a sample is met.
        given: the limits are the user's; else they are the range in which the model is known.
    """

    model: AbstractHysteresis
    solver: AbstractStepInverse
    low: Float[Array, ""]
    high: Float[Array, ""]
    tolerance: Float[Array, ""]
    given: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis | FitResult,
        *,
        limits: Limits | None = None,
        tolerance: float | None = None,
    ) -> InverseStep:
        """An inverse of a model, or of a fit.

        Args:
            model: any model without a delay or a resonance.
            limits: lowest and highest input; None for the range in which the model is known (of a fit: a little more than its data).
            tolerance: miss of the output up to which a sample is met; None for 1e-7 of what the model reaches.

        Raises:
            ModelError: a delay or a resonance; no limits where the inverse is a search and the model names no range.
        """
        known, own = _known(model)
        edges = limits if limits is not None else known
        low, high = (float(edge) for edge in edges) if edges is not None else (-np.inf, np.inf)
        if not low < high:
            raise ModelError(f"limits must be (low, high) with low < high, got {limits}")
        solver = step_inverse(own)
        travel = _travel(solver, low, high)
        if travel < 0:
            solver = step_inverse(own, -1.0)
        if solver.needs_limits and not (np.isfinite(low) and np.isfinite(high)):
            raise ModelError(
                f"the inverse of {type(own).__name__} is a search: give limits=(low, high), the inputs to search between"
            )
        if tolerance is None:
            tolerance = 1e-7 * abs(travel) or 1e-9
        numbers = (jnp.asarray(value, dtype=jnp.result_type(float)) for value in (low, high, tolerance))
        return cls(own, solver, *numbers, given=limits is not None)

    def init(self, u0: Any = 0.0) -> Resume:
        """The model at rest on an input."""
        u0 = jnp.asarray(u0, dtype=jnp.result_type(float))
        return Resume(self.model.init(u0), u0)

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

    def run(self, memory: Resume, targets: Float[Array, " T"], dt: Float[Array, " T"]) -> tuple[Resume, Answer]:
        """All samples of a reference in one scan."""
        return _run(self, memory, targets, dt)


@eqx.filter_jit
def _run(inverse: InverseStep, memory: Resume, targets: Array, dt: Array) -> tuple[Resume, Answer]:
    return jax.lax.scan(lambda m, sample: inverse.step(m, *sample), memory, (targets, dt))


@dataclasses.dataclass(frozen=True)
class Inverse:
    """What `invert` gives back.

    Attributes:
        u: input for every sample of the reference, shape (T,).
        y: output of the model for it, shape (T,).
        codes: `Status` of every sample as a number, shape (T,).
        start: where the model was before the first sample: `simulate(model, u, dt, resume=start)` gives y.
        state: where it is after the last one, to go on from.
    """

    u: np.ndarray
    y: np.ndarray
    codes: np.ndarray
    start: Resume
    state: Resume

    @property
    def status(self) -> tuple[str, ...]:
        """Status of every sample: "ok", "saturated", "not-monotone" or "out-of-range"."""
        return tuple(Status(int(code)).label for code in self.codes)

    @property
    def ok(self) -> bool:
        """Whether every sample is met."""
        return not self.codes.any()

    def counts(self) -> dict[str, int]:
        """How many samples have each status."""
        return {kind.label: int(np.count_nonzero(self.codes == kind)) for kind in Status}

    def notes(self) -> tuple[str, ...]:
        """What went wrong, one sentence each."""
        said = {
            Status.SATURATED: "lie beyond what the input's limits reach: the input is held there",
            Status.NOT_MONOTONE: "lie where the model's output does not rise with its input: the input may jump there",
            Status.OUT_OF_RANGE: "cannot be reached in the range in which the model is known: the nearest input is given",
        }
        found = {kind: np.flatnonzero(self.codes == kind) for kind in said}
        return tuple(
            f"{at.size} of {self.codes.size} samples, the first number {at[0]}, {said[kind]}"
            for kind, at in found.items()
            if at.size
        )


def invert(
    model: AbstractHysteresis | FitResult,
    reference: Any,
    dt: Any = None,
    *,
    resume: Resume | None = None,
    limits: Limits | None = None,
) -> Inverse:
    """The input that makes a model follow a reference.

    A resonance at the end of a `Series` is undone by leading the reference (see `lead`), everything before it sample by sample.

    Args:
        model: a model, or a fit.
        reference: wanted output, shape (T,); samples that are not finite hold the input.
        dt: time between samples, a number or shape (T,); a rate-independent model needs none.
        resume: state and last input before the first sample. None: the input on which the model, at rest, gives the first
            sample, as `simulate` starts; where rest gives the same output on every input, it rests on the input nearest zero.
        limits: lowest and highest input, which every driver has; None for the range in which the model is known.

    Raises:
        ModelError: no time for a model that needs it, a delay, no limits where a search needs them.
        DataError: a reference that is empty or of another shape than dt.
        PrecisionError: double precision is off.
    """
    require_x64()
    wanted = np.asarray(reference, dtype=float)
    if wanted.ndim != 1 or wanted.size == 0:
        raise DataError(f"the reference must have shape (T,) with T > 0, got {wanted.shape}")
    own = model if isinstance(model, AbstractHysteresis) else model.model
    if dt is None and not own.rate_independent:
        raise ModelError(f"{type(own).__name__} depends on time: give dt, the time between samples")
    given = np.asarray(0.0 if dt is None else dt, dtype=float)
    times = np.broadcast_to(given, wanted.shape) if given.ndim == 0 else given
    if times.shape != wanted.shape:
        raise DataError(f"dt must be a number or have the shape of the reference {wanted.shape}, got {times.shape}")
    if isinstance(own, Series) and isinstance(own.parts[-1], SecondOrder):
        return _invert_resonant(model, own, wanted, times, resume, limits)
    finite = wanted[np.isfinite(wanted)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    inverse = InverseStep.of(model, limits=limits, tolerance=1e-7 * span if span > 0 else None)
    targets, steps = jnp.asarray(wanted), jnp.asarray(times)
    start = _start(inverse, targets[0], steps[0]) if resume is None else resume
    end, answer = inverse.run(start, targets, steps)
    return Inverse(np.asarray(answer.u), np.asarray(answer.y), np.asarray(answer.status), start, end)


def _invert_resonant(
    model: Any, own: Series, wanted: np.ndarray, times: np.ndarray, resume: Resume | None, limits: Any
) -> Inverse:
    if resume is not None:
        raise ModelError("a model with a resonance is led, not stepped: its inverse starts from rest, leave resume out")
    *parts, resonance = own.parts
    rest = parts[0] if len(parts) == 1 else Series(*parts)
    edges = limits if limits is not None else _known(model)[0]
    led = lead(wanted, times, omega=float(resonance.omega), zeta=float(resonance.zeta))
    inner = invert(rest, led, times, limits=edges)
    from hystfit.models.base import simulate

    y, end = simulate(own, inner.u, times)
    codes = inner.codes
    if limits is None:
        codes = np.where(codes == Status.SATURATED, Status.OUT_OF_RANGE, codes)
    u0 = jnp.asarray(inner.u[0])
    return Inverse(inner.u, np.asarray(y), codes, Resume(own.init(u0), u0), end)


def _known(model: Any) -> tuple[tuple[float, float] | None, AbstractHysteresis]:
    """The inputs between which a model or fit is known, and the model."""
    if isinstance(model, AbstractHysteresis):
        return reach(model), model
    return known_range(model), model.model


def known_range(fit: FitResult) -> tuple[float, float]:
    """The inputs between which a fitted model is searched: those of its data, and a little more."""
    low = min(float(record.u.min()) for record in fit.data)
    high = max(float(record.u.max()) for record in fit.data)
    return low - _WIDER * (high - low), high + _WIDER * (high - low)


@eqx.filter_jit
def _at_rest(solver: AbstractStepInverse, u: Array, dt: Array) -> Array:
    return solver.advance(solver.model.init(u), u, u, dt)[1]


@eqx.filter_jit
def _across(solver: AbstractStepInverse, low: Array, high: Array) -> Array:
    state, first = solver.advance(solver.model.init(low), low, low, jnp.zeros_like(low))
    return solver.advance(state, low, high, jnp.zeros_like(low))[1] - first


def _travel(solver: AbstractStepInverse, low: float, high: float) -> float:
    """By how much the output moves on a way from the lower to the upper limit; 0 where they are not finite."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return 0.0
    edges = jnp.asarray([low, high], dtype=jnp.result_type(float))
    return float(_across(solver, edges[0], edges[1]))


@eqx.filter_jit
def _rest_on(inverse: InverseStep, target: Array, dt: Array, middle: Array, edges: Array) -> Array:
    miss = lambda u: _at_rest(inverse.solver, u, dt) - target
    sign = jnp.where(miss(edges[1]) < miss(edges[0]), -1.0, 1.0)
    return solve_rising(lambda u: sign * miss(u), middle, edges[0], edges[1]).x


def _start(inverse: InverseStep, target: Array, dt: Array) -> Resume:
    """The rest in which the model gives the first sample; at the input nearest zero where there is none."""
    low, high = float(inverse.low), float(inverse.high)
    middle = float(np.clip(0.0, low, high))
    if not bool(jnp.isfinite(target)):
        return inverse.init(middle)
    miss = lambda u: float(_at_rest(inverse.solver, jnp.asarray(u), dt)) - float(target)
    edges = low, high
    width = 1.0
    while not np.isfinite(edges).all() or (width > 1.0 and miss(edges[0]) * miss(edges[1]) > 0 and width < 1e12):
        edges = max(low, middle - width), min(high, middle + width)
        width *= 4.0
    u = _rest_on(inverse, target, dt, jnp.asarray(middle), jnp.asarray(edges))
    met = abs(miss(u)) <= float(inverse.tolerance)
    flat = miss(edges[0]) == miss(edges[1])
    return inverse.init(u if met and not flat else middle)
