"""Simulation: the dynamics of a model, and the scan that drives it with an input."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from hystfit.config import require_x64, shares_programs
from hystfit.data.batch import in_room
from hystfit.errors import ModelError, ParameterError
from hystfit.models.shared.sample_scan import first_samples, scan_samples
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.params.host_arrays import compiled
from hystfit.params.plain_module import PlainModule


class AbstractDynamics(PlainModule):
    """The interface of a model for simulation: `init` and `step` are required, the rest has defaults.

    The state is ONE array of one dimension: many small leaves in a scan carry make its gradient up to 80 times slower.
    """

    @property
    @abc.abstractmethod
    def rate_independent(self) -> bool:
        """Whether the output depends only on the order of the inputs, so that no time is needed."""

    @abc.abstractmethod
    def init(self, u0: Scalar) -> State:
        """State of the model in equilibrium at the input u0, with no history."""

    @abc.abstractmethod
    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Advance the state by one sample, from input u0 to u1 in the time dt: (new state, output at u1).

        Args:
            state: before the sample, shape (states,).
            u0: input of the previous sample [u].
            u1: input of this sample [u].
            dt: time between the two [s]; 0 where there is no time.
        """

    # -- optional ----------------------------------------------------------------------------------------------------------

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """Advance the state over all samples u: (state after the last, output at each). By default one scan of `step`.

        Override it to move work that does not depend on the state out of the scan.

        Args:
            state: before the first sample.
            u0: input before the first sample.
            u: input, shape (T,).
            dt: time since the sample before, shape (T,) [s].
        """
        single = state.shape == (1,)  # carried as a scalar: a loop over an array of one element is many times slower

        def body(state: Array, sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            state, y = self.step(state[None] if single else state, *sample)
            return (state[0] if single else state), y

        before = jnp.concatenate([u0[None], u[:-1]])
        state, y = scan_samples(body, state[0] if single else state, (before, u, dt))
        return (state[None] if single else state), y

    @property
    def one_scan(self) -> bool:
        """Whether a scan of `step` is as fast as `sweep`, so that sums over the samples can share it."""
        return True

    @property
    def jumps(self) -> bool:
        """Whether the output jumps where the input passes a threshold, which no derivative tells."""
        return False

    @property
    def searches(self) -> bool:
        """Whether a step searches for a root, which takes most of the time of a run."""
        return False

    @property
    def has_fast_run(self) -> bool:
        """Whether `free_run` is faster than a scan over the samples."""
        return False

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """The output of `simulate` on the host, shape (T,), by the fastest method that the model has.

        Args:
            u: input, shape (T,).
            dt: as in `simulate`.

        Raises:
            ModelError: as `simulate`.
        """
        if not (self.causal and shares_programs()):
            return np.asarray(simulate(self, u, dt)[0])
        u, dt = (np.asarray(values) for values in checked_drive(self, u, dt))
        try:
            return np.asarray(_outputs(self, in_room(u, hold=True), in_room(dt), np.int64(u.size)))[: u.size]
        except (TypeError, ValueError):
            check_one_device(self)
            raise

    def filtered(self, signals: np.ndarray, dt: np.ndarray) -> np.ndarray | None:
        """Outputs of a linear filter for each column of signals, (T, p), from rest at its first row; None where they need a program."""
        return None

    @property
    def causal(self) -> bool:
        """Whether the output depends on no later sample, so that `step` works and a simulation can be resumed."""
        return True


class Resume(NamedTuple):
    """The end of a simulation, from which it can be resumed: state of the model and the last input."""

    state: State
    u: Scalar


def simulate(
    model: AbstractDynamics,
    u: ArrayLike | Sequence[float],
    dt: ArrayLike | Sequence[float] | None = None,
    *,
    resume: Resume | None = None,
) -> tuple[Signal, Resume]:
    """Free run of a model over an input.

    Args:
        model: any model.
        u: input, shape (T,).
        dt: time since the previous sample, during which this input acts, shape (T,), or one number for all; rate-independent models need
            none.
        resume: what an earlier run returned, to continue it; None starts from `model.init(u[0])`.

    Returns:
        Output, shape (T,), and where the run stopped. Running two halves in turn equals one run.

    Raises:
        ModelError: no time for a model that needs it, shapes that do not fit, or a run of a model that is not causal to resume.
        ParameterError: the model holds several devices.
        PrecisionError: double precision is off.
    """
    if resume is not None and not model.causal:
        raise ModelError(
            f"the output of this {type(model).__name__} depends on later samples: simulate all samples in one run"
        )
    u, dt = checked_drive(model, u, dt)
    # dt[0] matters if the device rested at another input than u[0]: it has moved for that long at the first sample.
    try:
        y, *end = _run(model, u, dt, resume)
        return y, Resume(*end)
    except (TypeError, ValueError):
        check_one_device(model)
        raise


def checked_drive(model: AbstractDynamics, u: Any, dt: Any) -> tuple[Any, Any]:
    """Input and time steps as arrays of shape (T,), of JAX if they were, else of NumPy, which compiled code accepts without conversion.

    Raises:
        ModelError: no time for a model that needs it, or shapes that do not fit.
        PrecisionError: double precision is off.
    """
    require_x64()
    u = _floating(u)
    if u.ndim != 1 or u.size == 0:
        raise ModelError(f"the input must have shape (T,) with T > 0, got {u.shape}")
    if dt is None:
        if not model.rate_independent:
            raise ModelError(f"{type(model).__name__} depends on time: give dt, the time between samples")
        return u, np.zeros(u.shape)
    dt = _floating(dt)
    if dt.ndim == 0:
        dt = jnp.broadcast_to(dt, u.shape) if isinstance(dt, jax.Array) else np.full(u.shape, dt)
    if dt.shape != u.shape:
        raise ModelError(f"dt must have the shape of the input {u.shape}, got {dt.shape}")
    return u, dt


def _floating(values: Any) -> Any:
    """Values in double precision: an array of JAX if they are one, else of NumPy."""
    if isinstance(values, jax.Array):
        return values if values.dtype == np.float64 else values.astype(np.float64)
    return np.asarray(values, dtype=np.float64)


def run(
    model: AbstractDynamics, u: Array, dt: Array, resume: Resume | None = None, count: Array | int | None = None
) -> tuple[Array, Resume]:
    """`simulate` without checks or jit, for use inside other traced code; of the first `count` samples where this is given.

    What is behind the count is padding: the outputs there mean nothing, nor does the state at the end.
    """
    if resume is None:
        resume = Resume(model.init(u[0]), u[0])
    with first_samples(count):
        state, y = model.sweep(resume.state, resume.u, u, dt)
    return y, Resume(state, u[-1])


@compiled
def equilibrium(model: AbstractDynamics, u0: Array) -> Array:
    """State of a model in equilibrium at an input, compiled as one program instead of one per operation."""
    return model.init(u0)


@compiled
def _run(model: AbstractDynamics, u: Array, dt: Array, resume: Resume | None) -> tuple[Array, ...]:
    y, end = run(model, u, dt, resume)
    return y, *end


@compiled
def _outputs(model: AbstractDynamics, u: Array, dt: Array, count: Array) -> Array:
    return run(model, u, dt, count=count)[0]


def states_over(model: AbstractDynamics, u: Any, dt: Any) -> np.ndarray:
    """State after each sample of a run of a causal model, shape (T, states); in some models the linear weights multiply it."""
    u, dt = (np.asarray(values) for values in checked_drive(model, u, dt))
    return np.asarray(_states(model, in_room(u, hold=True), in_room(dt), np.int64(u.size)))[: u.size]


@compiled
def _states(model: AbstractDynamics, u: Array, dt: Array, count: Array) -> Array:
    def once(state: Array, sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        state = model.step(state, *sample)[0]
        return state, state

    begin = model.init(u[0])
    with first_samples(count):
        return scan_samples(once, begin, (jnp.concatenate([u[:1], u[:-1]]), u, dt))[1]


def check_one_device(model: Any) -> None:
    """Refuse a model whose parameters have a leading axis, one element per device."""
    if any(np.ndim(leaf) == 0 for leaf in jax.tree.leaves(model)):
        return
    zero = jnp.zeros(())
    try:
        shape = jax.eval_shape(lambda m: m.step(m.init(zero), zero, zero, zero)[1], model).shape
    except (TypeError, ValueError):
        shape = None
    if shape != ():
        raise ParameterError(
            f"{type(model).__name__} holds several devices: take one by jax.tree.map(lambda leaf: leaf[0], model), or make them "
            "by Actuator.population or Stage.population"
        )
