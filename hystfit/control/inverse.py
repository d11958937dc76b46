"""The inverse of a model: the input that makes it follow a reference, with a status for every sample."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.config import verb
from hystfit.control.online_inverse import InverseStep, Limits, Status, fitted_inputs
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.bracketed import solve_rising
from hystfit.models.shared.simulation import Resume, equilibrium, simulate
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.host_arrays import compiled, to_device

if TYPE_CHECKING:
    from hystfit.results.result import FitResult


@dataclasses.dataclass(frozen=True)
class Inverse:
    """Result of `invert`.

    Attributes:
        u: input for every sample of the reference, shape (T,).
        y: output of the model for it, shape (T,).
        codes: `Status` of every sample as a number, shape (T,).
        start: state and input before the first sample: `simulate(model, u, dt, resume=start)` gives y.
        state: state and input after the last sample, from which another call continues.
        obstacle: why the fitted model has no inverse over the whole range of its data; None where it has one, or for a bare model.
    """

    u: np.ndarray
    y: np.ndarray
    codes: np.ndarray
    start: Resume
    state: Resume
    obstacle: str | None = None

    def __repr__(self) -> str:
        counts = ", ".join(f"{many} {label}" for label, many in self.counts().items() if many)
        return f"Inverse({self.u.size} samples: {counts}; u from {self.u.min():.4g} to {self.u.max():.4g})"

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
        """Warnings, one sentence each."""
        texts = {
            Status.SATURATED: "cannot be reached within the limits of the input: the input stays at its limit there",
            Status.NOT_MONOTONE: "lie where the output of the model does not rise with its input: the input may jump there; "
            "if rate terms (viscous, saturating-rate) cause this, fit a model with lag+ in place of them",
            Status.OUT_OF_RANGE: "cannot be reached in the range in which the model is known: the nearest input is given",
        }
        places = {kind: np.flatnonzero(self.codes == kind) for kind in texts}
        whole = () if self.obstacle is None else (f"the model has no inverse over its whole range: {self.obstacle}",)
        return whole + tuple(
            f"{at.size} of {self.codes.size} samples (first: sample {at[0]}) {texts[kind]}"
            for kind, at in places.items()
            if at.size
        )


def invert(
    model: AbstractHysteresis | FitResult,
    reference: Any,
    dt: Any = None,
    *,
    resume: Resume | None = None,
    rest: float | None = None,
    limits: Limits | None = None,
) -> Inverse:
    """The input that makes a model follow a reference.

    A resonance at the end of a `Series` is inverted by filtering the reference (see `lead`), everything before it sample by sample.

    Args:
        model: a model, or a fit.
        reference: desired output, shape (T,); where it is not finite, the input keeps its value.
        dt: time between samples, a number or shape (T,); a rate-independent model needs none.
        resume: state and last input before the first sample, from which a call continues another.
        rest: input at which the device was in equilibrium before the first sample (see `Record.resting_on`), for a model with a lag or
            creep. Without `resume` and `rest`: the input on which the model, in equilibrium, gives the first sample, as `simulate`
            starts; where equilibrium gives the same output at every input, the input nearest zero.
        limits: lowest and highest input, such as those of the amplifier; None for the range in which the model is known.

    Raises:
        ModelError: no time for a model that needs it, a delay, no limits where a search needs them.
        DataError: a reference that is empty or of another shape than dt; a rest input that is not finite.
        ParameterError: both `resume` and `rest`.
        PrecisionError: double precision is off.
    """
    task = prepare(model, reference, dt, resume=resume, rest=rest, limits=limits)
    obstacle = None if isinstance(model, AbstractHysteresis) else model.obstacle("inverse")
    if task.inverse is None:
        return dataclasses.replace(_invert_resonant(model, task, rest, limits), obstacle=obstacle)
    end, answer = task.inverse.run(task.start, task.wanted, task.steps)
    return Inverse(np.asarray(answer.u), np.asarray(answer.y), np.asarray(answer.status), task.start, end, obstacle)


class Task(NamedTuple):
    """An inversion made ready, on arrays only: tasks of one model with other parameters stack, for `jax.vmap`.

    `inverse` and `start` are None where a resonance is led instead of an inverse sample by sample.
    """

    inverse: InverseStep | None
    start: Any
    wanted: Array
    steps: Array


@verb
def prepare(
    model: AbstractHysteresis | FitResult,
    reference: Any,
    dt: Any = None,
    *,
    resume: Resume | None = None,
    rest: float | None = None,
    limits: Limits | None = None,
) -> Task:
    """The inversion that `invert` runs; arguments and errors are those of `invert`."""
    if rest is not None and resume is not None:
        raise ParameterError("resume= continues from a state, rest= starts in equilibrium: give one of them")
    if rest is not None and not np.isfinite(rest):
        raise DataError(f"the input at rest must be finite, got {rest}")
    wanted = np.asarray(reference, dtype=float)
    if wanted.ndim != 1 or wanted.size == 0:
        raise DataError(f"the reference must have shape (T,) with T > 0, got {wanted.shape}")
    inverted = model if isinstance(model, AbstractHysteresis) else model.device
    if dt is None and not inverted.rate_independent:
        raise ModelError(f"{type(inverted).__name__} depends on time: give dt, the time between samples")
    given = np.asarray(0.0 if dt is None else dt, dtype=float)
    times = np.broadcast_to(given, wanted.shape) if given.ndim == 0 else given
    if times.shape != wanted.shape:
        raise DataError(f"dt must be a number or have the shape of the reference {wanted.shape}, got {times.shape}")
    targets, steps = to_device(wanted), to_device(times)
    resonance = inverted.output_resonance()
    if resonance is not None and resonance.model is not None:
        if resume is not None:
            raise ModelError(
                "a model with a resonance at its end is inverted as a whole and starts in equilibrium: leave out resume="
            )
        return Task(None, None, targets, steps)
    finite = wanted[np.isfinite(wanted)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    inverse = InverseStep.of(model, limits=limits, tolerance=1e-7 * span if span > 0 else None)
    if resume is not None:
        start = resume
    else:
        start = _start(inverse, float(wanted[0]), to_device(times[0])) if rest is None else inverse.init(rest)
    return Task(inverse, start, targets, steps)


def _invert_resonant(model: Any, task: Task, rest: float | None, limits: Any) -> Inverse:
    known, inverted = fitted_inputs(model)
    resonant = inverted.output_resonance()
    assert resonant is not None
    assert resonant.model is not None
    wanted, times = np.asarray(task.wanted), np.asarray(task.steps)
    edges = limits if limits is not None else known
    leading = lead(wanted, times, omega=resonant.omega, zeta=resonant.zeta)
    inner = invert(resonant.model, leading, times, rest=rest, limits=edges)
    u0 = jnp.asarray(inner.u[0] if rest is None else rest, dtype=float)
    start = Resume(equilibrium(inverted, u0), u0)
    y, end = simulate(inverted, inner.u, times, resume=start)
    codes = inner.codes
    if limits is None:
        codes = np.where(codes == Status.SATURATED, Status.OUT_OF_RANGE, codes)
    return Inverse(inner.u, np.asarray(y), codes, start, end)


def _at_rest(solver: AbstractStepInverse, u: Array, dt: Array) -> Array:
    return solver.advance(solver.model.init(u), u, u, dt)[1]


@compiled
def _both_at_rest(solver: AbstractStepInverse, inputs: Array, dt: Array) -> Array:
    """Outputs at rest on two inputs, in one loop, so that the model is compiled once."""
    return jax.lax.map(lambda u: _at_rest(solver, u, dt), inputs)


@compiled
def _rest_on(solver: AbstractStepInverse, target: Array, dt: Array, sign: Array, where: Array) -> Array:
    """The input at rest on which the output is the target; `where`: a first guess, and the lowest and highest input."""
    return solve_rising(lambda u: sign * (_at_rest(solver, u, dt) - target), *where).x


def _start(inverse: InverseStep, target: float, dt: Array) -> Resume:
    """The state at rest whose output is the first sample; where there is none, in equilibrium at the input nearest zero."""
    low, high = float(inverse.low), float(inverse.high)
    middle = float(np.clip(0.0, low, high))
    if not np.isfinite(target):
        return inverse.init(middle)
    misses = lambda *inputs: np.asarray(_both_at_rest(inverse.solver, np.array(inputs), dt)) - target
    edges, width = (low, high), 1.0
    while not np.isfinite(edges).all() or (width > 1.0 and np.prod(misses(*edges)) > 0 and width < 1e12):
        edges = max(low, middle - width), min(high, middle + width)
        width *= 4.0
    first, last = misses(*edges)
    sign = np.asarray(-1.0 if last < first else 1.0)
    u = float(_rest_on(inverse.solver, np.asarray(target), dt, sign, np.array([middle, *edges])))
    met = abs(misses(u, u)[0]) <= float(inverse.tolerance)
    return inverse.init(u if met and first != last else middle)


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
