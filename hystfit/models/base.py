"""The base class of all models: parameters as fields, dynamics as `init` and `step`, simulation by one scan."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from hystfit.config import require_x64
from hystfit.data.record import Record
from hystfit.data.steady_cycle import with_steady_start
from hystfit.errors import ModelError, ParameterError
from hystfit.models.c_code import CPart
from hystfit.models.default_start import hypercube_start
from hystfit.models.description import format_model
from hystfit.models.design import Block, DesignMatrix
from hystfit.models.one_device import check_one_device
from hystfit.models.parallel.associative import StateMap, sweep_at_once
from hystfit.models.parallel.kernel import scan
from hystfit.models.parallel.route import Route, route
from hystfit.models.shapes import Scalar, Signal, State
from hystfit.models.step_inverse import AbstractStepInverse, SearchStep
from hystfit.params.host_arrays import compiled
from hystfit.params.param import leaves_of
from hystfit.params.space import ParameterSpace
from hystfit.quality.needs import Needs

Use = Literal["inverse", "export"]


class AbstractHysteresis(eqx.Module):
    """A hysteresis model: `init` returns the state at rest on an input, `step` advances it by one sample.

    The state is ONE array of one dimension: many small leaves in a scan carry make its gradient up to 80 times slower.

    A model must give `rate_independent` (`ClassVar[bool]`; compositions derive it from their parts), `init` and `step`. The methods
    below `step` are optional: each has a default here, a model overrides those that it can do better, `start` first, and `Sum` and
    `Series` delegate all of them to their parts. `hystfit.testing.check_model` tests what a model gives.
    """

    @property
    @abc.abstractmethod
    def rate_independent(self) -> bool:
        """Whether the output depends only on the order of the inputs, so that no time is needed."""

    @abc.abstractmethod
    def init(self, u0: Scalar) -> State:
        """State of the model at rest on the input u0, with no history."""

    @abc.abstractmethod
    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """Advance the state by one sample, from input u0 to u1 in the time dt: (new state, output at u1).

        Args:
            state: before the sample, shape (states,).
            u0: input of the previous sample [u].
            u1: input of this sample [u].
            dt: time between the two [s]; 0 where there is no time.
        """

    # -- values ------------------------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return format_model(self)

    def replace(self, **values: Any) -> AbstractHysteresis:
        """The same model with other values of some parameters.

        Args:
            **values: by name; those of elements and of parts of a composition as `replace(**{"w[2]": 0.1, "bouc_wen.tau": 3.0})`.

        Raises:
            ParameterError: an unknown name, or a value that is not finite or outside the bounds of its parameter.
        """
        if missing := [name for name, value in values.items() if value is None]:
            raise ParameterError(f"parameter {missing[0]!r} needs a value, got None")
        return ParameterSpace.of(self, fix=values).template

    # -- optional: simulation ----------------------------------------------------------------------------------------------

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """Advance the state over all samples u: (state after the last, output at each). By default one scan of `step`.

        To override where part of the work does not depend on the state, and need not be in the scan.

        Args:
            state: before the first sample.
            u0: input before the first sample.
            u: input, shape (T,).
            dt: time since the sample before, shape (T,) [s].
        """
        single = state.shape == (1,)  # carried as a number: a loop that gathers a row of one is many times slower

        def body(state: Array, sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            state, y = self.step(state[None] if single else state, *sample)
            return (state[0] if single else state), y

        before = jnp.concatenate([u0[None], u[:-1]])
        state, y = scan(body, state[0] if single else state, (before, u, dt))
        return (state[None] if single else state), y

    # What `step` does to the state, where it is one of the maps that compose.
    state_map: ClassVar[StateMap | None] = None

    @property
    def associative(self) -> bool:
        """Whether `sweep_at_once` needs no scan over the samples."""
        return self.state_map is not None

    def sweep_at_once(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """`sweep` by an associative scan where `state_map` is set: for long records on a GPU.

        Args:
            state: before the first sample.
            u0: input before the first sample.
            u: input, shape (T,).
            dt: time since the sample before, shape (T,) [s].
        """
        if self.state_map is None:
            return self.sweep(state, u0, u, dt)
        return sweep_at_once(self.step, self.state_map, state, u0, u, dt)

    @property
    def one_scan(self) -> bool:
        """Whether a scan of `step` is as fast as `sweep`, so that sums over the samples can share it."""
        return True

    @property
    def has_fast_run(self) -> bool:
        """Whether `free_run` is faster than a scan over the samples."""
        return False

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """The output of `simulate` on the host, shape (T,), in the fastest way that the model has.

        Args:
            u: input, shape (T,).
            dt: as in `simulate`.

        Raises:
            ModelError: as `simulate`.
        """
        return np.asarray(simulate(self, u, dt)[0])

    @property
    def linear_in_input(self) -> bool:
        """Whether the output is linear in the signal that comes in, apart from a constant of the initial state: linear filters."""
        return False

    @property
    def delays(self) -> bool:
        """Whether the model has a pure delay."""
        return False

    @property
    def causal(self) -> bool:
        """Whether the output depends on no later sample, so that `step` works and a simulation can be resumed."""
        return True

    def settings(self) -> dict[str, int | bool | str]:
        """Choices besides the values of parameters, as they follow a name (`preisach:n=60`): whole numbers, words and switches.

        By default the fields that are not parameters; to override where the model is built by other settings than its fields.
        """
        values = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        return {name: value for name, value in values if isinstance(value, (int, str))}

    # -- optional: fitting ---------------------------------------------------------------------------------------------------

    def start(self, records: Sequence[Record]) -> AbstractHysteresis:
        """The same model with starting values estimated from measured records (host side, no gradient).

        By default the best of a Latin hypercube within the bounds and the data's scales; to override where the loop shows them.
        """
        return hypercube_start(self, records)

    @property
    def allows_thinning(self) -> bool:
        """Whether a simulation on every k-th sample is near enough for starting values: no delay or resonance of a few samples."""
        return self.rate_independent

    def prepared(self, record: Record) -> Record:
        """The record as it is fitted: samples that the model cannot describe have weight 0.

        By default a record that begins with a steady period follows that period once more, without weight, because its first sample
        lies on a branch. A record whose device rested before is `Record.resting_on` the input there.

        Raises:
            ModelError: a record that cannot drive the model.
        """
        return with_steady_start(record)

    def starting_points(self, records: Sequence[Record]) -> tuple[AbstractHysteresis, ...]:
        """Models with starting values estimated from measured records, the best first: by default that of `start` alone."""
        return (self.start(records),)

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Warnings about using this model on an input; none by default.

        Args:
            u: input, shape (T,).
            dt: time since the sample before, shape (T,) [s].
        """
        return ()

    def hysteretic_share(self, u: np.ndarray, dt: np.ndarray) -> float | None:
        """Share of the dissipated energy that hysteresis takes, of a model that dissipates by rate as well; None for others.

        Args:
            u: input, shape (T,).
            dt: time since the sample before, shape (T,) [s].
        """
        return None

    def derived(self) -> tuple[Derived, ...]:
        """Quantities that follow from its parameters, which a fit reports with their standard errors."""
        return ()

    def plays(self) -> tuple[PlayWeights, ...]:
        """Weights of plays or stops by threshold, for pictures; none by default."""
        return ()

    def plane(self) -> Any:
        """The `Preisach` whose density describes the model, for pictures; None where there is none."""
        return None

    @property
    def needs(self) -> Needs | None:
        """The data needed to determine the parameters; None where this is not declared."""
        return None

    @property
    def estimator(self) -> str | None:
        """Name of the preferred estimator; None where the number of bounded linear weights decides."""
        return None

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The design matrix of the linear weights, at the present values of the other parameters.

        By differentiation of the simulation; to override where the columns are known in closed form.

        Args:
            u: input, shape (T,).
            dt: as in `simulate`.
        """
        leaves = [leaf for leaf in leaves_of(self) if leaf.size and leaf.info.linear and _solvable(leaf.info.bounds)]
        u, dt = drive(self, u, dt)
        rest, columns = _output_and_jacobian(self, tuple(leaf.index for leaf in leaves), u, dt)
        blocks = (
            Block(leaf.index, leaf.info, np.asarray(part).reshape(u.size, -1))
            for leaf, part in zip(leaves, columns, strict=True)
        )
        return DesignMatrix(tuple(blocks), np.asarray(rest), np.arange(u.size))

    @property
    def has_rest(self) -> bool:
        """Whether the model can rest before the record on its `level` or on the record's "first" input (see `with_rest`)."""
        return False

    def with_rest(self, rest: str) -> AbstractHysteresis:
        """The same model, at rest before the record on its "level" or on the record's "first" input."""
        return self

    @property
    def from_saturation(self) -> bool:
        """Whether every record starts from saturation, so that its input need not turn back (reversal curves)."""
        return False

    def sizes(self, records: Sequence[Record]) -> dict[str, AbstractHysteresis]:
        """Models of its kind that a comparison should try on these records, by their size in words.

        First the model itself, where needed with fewer elements than given, as many as the records can determine; then models that
        differ from it by one choice: the number of elements, where they are, the state before the records. Empty where there is
        nothing to choose.
        """
        return {}

    def without_creep(self) -> AbstractHysteresis | None:
        """The same model with its creep set to zero; None for a model that has no creep."""
        return None

    # -- optional: control ---------------------------------------------------------------------------------------------------

    def reach(self) -> tuple[float, float] | None:
        """Lowest and highest input for which the model is defined; None where it has no such range."""
        return None

    def inputs_between(self, low: float, high: float) -> tuple[float, float]:
        """Limits of the input within which a filter puts out signals between two values: a static gain of one by default."""
        return low, high

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """The one-sample inverse: a closed form, or by default a bracketed search.

        Args:
            sign: of a search; -1 for outputs that fall with the input.

        Raises:
            ModelError: the model has no causal inverse (a delay, a resonance).
        """
        return SearchStep(self, sign)

    def output_resonance(self) -> OutputResonance | None:
        """The resonance at the end of the model, which is inverted by leading the reference; None where there is none."""
        return None

    def obstacle(self, use: Use) -> str | None:
        """The reason why the model cannot be inverted or exported to C; None where it can.

        A resonance at the end of a model is not an obstacle to an inverse, because the reference leads it.
        """
        try:
            if use == "export":
                self.c_part()
            elif self.output_resonance() is None:
                self.step_inverse()
        except ModelError as error:
            return str(error)
        return None

    def c_part(self) -> CPart:
        """The model's part of the exported C code.

        Raises:
            ModelError: the model has no C code.
        """
        raise ModelError(f"{type(self).__name__} has no C code: give it a method c_part (see hystfit.models.c_code)")


class Derived(NamedTuple):
    """A quantity that follows from the parameters of a model: name, unit expression in u, y and s, meaning, function of the model."""

    name: str
    unit: str
    doc: str
    value: Callable[[Any], Array]


class OutputResonance(NamedTuple):
    """A resonance at the end of a model: the model before it (None where there is nothing), omega [rad/s] and zeta."""

    model: AbstractHysteresis | None
    omega: float
    zeta: float


def _solvable(bounds: tuple[float, float]) -> bool:
    """Weights that are free or >= 0 can be solved for in one quadratic program."""
    return bounds[1] == np.inf and bounds[0] in (0.0, -np.inf)


@compiled
def _output_and_jacobian(model: Any, at: tuple[int, ...], u: Array, dt: Array) -> tuple[Array, list[Array]]:
    """Output with the leaves `at` set to zero, and its derivatives in them."""
    leaves, treedef = jax.tree_util.tree_flatten(model)

    def output(values: list[Array]) -> Array:
        flat = list(leaves)
        for k, value in zip(at, values, strict=True):
            flat[k] = value
        return run(treedef.unflatten(flat), u, dt)[0]

    zero = [jnp.zeros_like(leaves[k]) for k in at]
    return output(zero), jax.jacfwd(output)(zero) if at else []


# -- simulation ------------------------------------------------------------------------------------------------------------------


def check_rest(rest: str) -> None:
    """Refuse an unknown state of rest before a record.

    Raises:
        ModelError: neither "level" nor "first".
    """
    if rest not in ("level", "first"):
        raise ModelError(f"rest must be level or first, got {rest!r}")


class PlayWeights(NamedTuple):
    """Weights of the plays or stops of one envelope.

    Attributes:
        label: of the envelope and operator.
        threshold: half width of each, rising [u], shape (n,).
        weight: of each [y], shape (n,).
        names: of the parameters that are the weights.
    """

    label: str
    threshold: np.ndarray
    weight: np.ndarray
    names: tuple[str, ...]


class Resume(NamedTuple):
    """The end of a simulation, from which it can be resumed: state of the model and the last input."""

    state: State
    u: Scalar


def simulate(
    model: AbstractHysteresis,
    u: ArrayLike | Sequence[float],
    dt: ArrayLike | Sequence[float] | None = None,
    *,
    resume: Resume | None = None,
) -> tuple[Signal, Resume]:
    """Free run of a model over an input.

    Args:
        model: any model.
        u: input, shape (T,).
        dt: time over which each input acted before its sample was read, shape (T,), or one number for all: the time
            since the sample before. A rate-independent model needs none.
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
    u, dt = _checked_drive(model, u, dt)
    # dt[0] counts: a device that rested on another input than u[0] has moved for that long when the first sample is read.
    try:
        y, *end = _run(model, u, dt, resume)
        return y, Resume(*end)
    except (TypeError, ValueError):
        check_one_device(model)
        raise


def drive(model: AbstractHysteresis, u: Any, dt: Any) -> tuple[Array, Array]:
    """Input and time steps as arrays of shape (T,).

    Args:
        model: to be driven.
        u: input, shape (T,).
        dt: see `simulate`.

    Raises:
        ModelError: no time for a model that needs it, or shapes that do not fit.
        PrecisionError: double precision is off.
    """
    u, dt = _checked_drive(model, u, dt)
    return jnp.asarray(u), jnp.asarray(dt)


def _checked_drive(model: AbstractHysteresis, u: Any, dt: Any) -> tuple[Any, Any]:
    """`drive` without conversion to JAX arrays: compiled code accepts NumPy arrays faster than they convert here."""
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
    """Values in double precision: as an array of JAX where they are one, else in NumPy."""
    if isinstance(values, jax.Array):
        return values if values.dtype == np.float64 else values.astype(np.float64)
    return np.asarray(values, dtype=np.float64)


def run(model: AbstractHysteresis, u: Array, dt: Array, resume: Resume | None = None) -> tuple[Array, Resume]:
    """`simulate` without checks or jit, for use inside other traced code.

    Args:
        model: any model.
        u: input, shape (T,).
        dt: time since the sample before, shape (T,) [s].
        resume: see `simulate`.
    """
    if resume is None:
        resume = Resume(model.init(u[0]), u[0])
    if route(u.shape[0], associative=model.associative) is Route.ASSOCIATIVE:
        state, y = model.sweep_at_once(resume.state, resume.u, u, dt)
    else:
        state, y = model.sweep(resume.state, resume.u, u, dt)
    return y, Resume(state, u[-1])


@compiled
def _run(model: AbstractHysteresis, u: Array, dt: Array, resume: Resume | None) -> tuple[Array, ...]:
    """`run`, compiled."""
    y, end = run(model, u, dt, resume)
    return y, *end
