"""What every model is: parameters as fields, dynamics as two methods, one scan that runs them all."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError


class AbstractHysteresis(eqx.Module):
    """A hysteresis model: `init` makes the state at rest on an input, `step` moves it over one sample.

    The state is ONE array of one dimension: many small leaves in a scan carry make its gradient up to 80 times slower.

    Concrete classes say `rate_independent: ClassVar[bool]`, compositions derive it from their parts.
    """

    @property
    @abc.abstractmethod
    def rate_independent(self) -> bool:
        """The output depends on the order of the inputs alone, so that no time is needed."""

    @abc.abstractmethod
    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State of the model at rest on the input u0, with no history."""

    @abc.abstractmethod
    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """Move the input from u0 to u1 in the time dt: (new state, output at the new sample)."""

    def sweep(
        self,
        state: Float[Array, " state"],
        u0: Float[Array, ""],
        u: Float[Array, " T"],
        dt: Float[Array, " T"],
        unroll: int = 1,
    ) -> tuple[Float[Array, " state"], Float[Array, " T"]]:
        """Move the input from u0 over all samples u: (state after the last, output at each). One scan of `step`.

        A model may do better: what does not depend on the state need not be in the scan.
        """
        single = state.shape == (1,)  # carried as a number: a loop that gathers a row of one is many times slower

        def body(state: Array, sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            state, y = self.step(state[None] if single else state, *sample)
            return (state[0] if single else state), y

        before = jnp.concatenate([u0[None], u[:-1]])
        state, y = jax.lax.scan(body, state[0] if single else state, (before, u, dt), unroll=unroll)
        return (state[None] if single else state), y

    @abc.abstractmethod
    def start(self, records: Sequence[Record]) -> AbstractHysteresis:
        """The same model with starting values read off measured records (host side, no gradient)."""

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """What a user should know before trusting this model on an input u of shape (T,); nothing by default."""
        return ()


class AbstractFilter(AbstractHysteresis):
    """Linear dynamics with gain one, before or after a hysteresis: it delays or smooths, and adds no loop of its own shape."""


def check_rest(rest: str) -> None:
    """Refuse what is no place of rest before a record.

    Raises:
        ModelError: neither "level" nor "first".
    """
    if rest not in ("level", "first"):
        raise ModelError(f"rest must be level or first, got {rest!r}")


class Resume(NamedTuple):
    """Where a simulation stopped, to go on from: state of the model and the last input."""

    state: Float[Array, " state"]
    u: Float[Array, ""]


def simulate(
    model: AbstractHysteresis,
    u: ArrayLike | Sequence[float],
    dt: ArrayLike | Sequence[float] | None = None,
    *,
    resume: Resume | None = None,
    unroll: int = 1,
) -> tuple[Float[Array, " T"], Resume]:
    """Free run of a model over an input.

    Args:
        model: any model.
        u: input, shape (T,).
        dt: time over which each input acted before its sample was read, shape (T,), or one number for all: the time
            since the sample before. A rate-independent model needs none.
        resume: what an earlier run returned, to continue it; None starts from `model.init(u[0])`.
        unroll: of the scan; 1 under differentiation, 4 to 8 for a fast plain run of a small model.

    Returns:
        Output, shape (T,), and where the run stopped. Running two halves in turn equals one run.

    Raises:
        ModelError: no time for a model that needs it, or shapes that do not fit.
    """
    u = jnp.asarray(u, dtype=jnp.result_type(float))
    if u.ndim != 1 or u.size == 0:
        raise ModelError(f"the input must have shape (T,) with T > 0, got {u.shape}")
    if dt is None and not model.rate_independent:
        raise ModelError(f"{type(model).__name__} depends on time: give dt, the time between samples")
    dt = jnp.asarray(0.0 if dt is None else dt, dtype=u.dtype)
    dt = jnp.broadcast_to(dt, u.shape) if dt.ndim == 0 else dt
    if dt.shape != u.shape:
        raise ModelError(f"dt must have the shape of the input {u.shape}, got {dt.shape}")
    # dt[0] counts: a device that rested on another input than u[0] has moved for that long when the first sample is read.
    return _simulate(model, u, dt, resume, unroll)


@eqx.filter_jit
def _simulate(model: Any, u: Array, dt: Array, resume: Resume | None, unroll: int) -> tuple[Array, Resume]:
    return run(model, u, dt, resume, unroll)


def run(
    model: AbstractHysteresis, u: Array, dt: Array, resume: Resume | None = None, unroll: int = 1
) -> tuple[Array, Resume]:
    """`simulate` without checks or jit, for use inside other traced code."""
    if resume is None:
        resume = Resume(model.init(u[0]), u[0])
    state, y = model.sweep(resume.state, resume.u, u, dt, unroll)
    return y, Resume(state, u[-1])
