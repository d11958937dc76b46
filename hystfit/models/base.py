"""The base class of all models: parameters as fields, dynamics as `init` and `step`, and what fits and controllers use."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.batch import in_room
from hystfit.data.record import Record
from hystfit.data.steady_cycle import with_steady_start
from hystfit.errors import ModelError, ParameterError
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.default_start import hypercube_start
from hystfit.models.shared.design import COLUMNS, Block, DesignMatrix
from hystfit.models.shared.reported import Derived, PlayWeights, format_model
from hystfit.models.shared.simulation import AbstractDynamics, checked_drive, run
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.step_inverse import AbstractStepInverse, SearchStep
from hystfit.models.shared.uniaxial_material import UniaxialMaterial
from hystfit.params.host_arrays import compiled
from hystfit.params.param import leaves_of
from hystfit.params.space import ParameterSpace
from hystfit.quality.needs import Needs

Use = Literal["inverse", "export"]
Rest = Literal["level", "first"]


class AbstractHysteresis(AbstractDynamics):
    """A hysteresis model: `init` returns the state in equilibrium at an input, `step` advances it by one sample (`AbstractDynamics`).

    A model must give `rate_independent` (`ClassVar[bool]`; compositions derive it from their parts), `init` and `step`. All other
    methods are optional: each has a default, a model overrides those that it can do better, `start` first, and `Sum` and `Series`
    delegate all of them to their parts. `hystfit.testing.check_model` tests what a model gives.
    """

    no_inverse: ClassVar[str] = ""
    """Reason why models of this class have no inverse, with {name} for the class name; "" if they have one."""
    counts: ClassVar[Mapping[str, str]] = {}
    """Settings that give the number of elements of a parameter: names of parameters by setting."""
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Allowed words of the fields that take one, by field."""
    c_template: ClassVar[str] = ""
    """Name of the template of its C code, if the template needs only the fields (`CPart.of`)."""

    # -- values ------------------------------------------------------------------------------------------------------------

    def __check_init__(self) -> None:
        for name, known in self.words.items():
            if (word := getattr(self, name)) not in known:
                raise ModelError(f"{name} must be {', '.join(known[:-1])} or {known[-1]}, got {word!r}")

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

    def settings(self) -> dict[str, int | bool | str]:
        """Settings besides parameter values, as written after a name (`preisach:n=60`): whole numbers, words and switches.

        By default the numbers of elements in `counts`, and the fields that are not parameters; override it where a constructor takes
        other settings.
        """
        values = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        plain = {name: value for name, value in values if isinstance(value, (int, str))}
        return {name: getattr(self, field).shape[-1] for name, field in self.counts.items()} | plain

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of constants of a record on which its parameters depend (see `Varying`)."""
        return ()

    def of_record(self, record: Record) -> AbstractHysteresis:
        """The same model at the covariates of a record."""
        return self

    def outside(self) -> list[str]:
        """Texts that name covariates outside the fitted range."""
        return []

    @property
    def linear_in_input(self) -> bool:
        """Whether the output is linear in the input signal, apart from a constant from the initial state (linear filters)."""
        return False

    @property
    def delays(self) -> bool:
        """Whether the model has a pure delay."""
        return False

    @property
    def takes_rate(self) -> bool:
        """Whether the output depends on the input rate over the interval before a sample, which is unknown at the first sample."""
        return False

    @property
    def hysteretic(self) -> bool:
        """Whether slow cycles leave its loop open; False for curves and linear filters."""
        return True

    @property
    def memoryless(self) -> bool:
        """Whether the output is a function of the present input alone."""
        return not self.hysteretic and self.rate_independent and not self.delays

    @property
    def creeps(self) -> bool:
        """Whether the output may go on changing for seconds after a step of the input; a lag, a resonance and a viscous term do not."""
        return not self.rate_independent

    @property
    def has_inverse(self) -> bool:
        """Whether `check` may propose the model without the extra margin for models that have no inverse.

        True for any model without a delay, even with `no_inverse`: with the margin, `check` would not propose `damper` for a damper.
        """
        return not self.delays

    @property
    def either_way(self) -> bool:
        """Whether the model describes loops of both directions and outputs that fall as the input rises, regardless of `needs`."""
        return False

    @property
    def hardens(self) -> bool:
        """Whether the loop changes with the path length of the input, so that a new device differs from a used one."""
        return False

    @property
    def degrades(self) -> bool:
        """Whether the model describes loops that lose strength or stiffness."""
        return self.needs is not None and self.needs.damage

    # -- optional: fitting ---------------------------------------------------------------------------------------------------

    def start(self, records: Sequence[Record]) -> AbstractHysteresis:
        """The same model with starting values estimated from measured records (host side, no gradient).

        By default the best of a Latin hypercube within the bounds and the data's scales; override it where the loop shows them.
        """
        return hypercube_start(self, records)

    @property
    def allows_thinning(self) -> bool:
        """Whether starting values may be fitted on every k-th sample: not with a delay or resonance of a few samples."""
        return self.rate_independent

    def prepared(self, record: Record) -> Record:
        """The record as it is fitted: samples that the model cannot describe have weight 0.

        By default a record that starts with a steady period is preceded by one more copy of that period, with weight 0, because its first
        sample lies on a branch. For a device that rested before the record, use `Record.resting_on`. If the output depends on the input
        rate and the input moves from the start, the first sample has weight 0, because its rate is unknown.

        Raises:
            ModelError: a record that cannot drive the model.
        """
        if self.takes_rate and not record.rate_known.all():
            record = record.replace(weight=np.where(record.rate_known, record.weight, 0.0))
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

    def step_ratio(self, largest: Any) -> Any:
        """Largest step of the input over the largest for which the scheme is accurate; there is `advice` if it exceeds 1.

        None for models whose advice depends on more than this. A leading axis of N of the parameters is kept.

        Args:
            largest: largest step of the input between two samples, or of N inputs [u].
        """
        return None

    def hysteretic_share(self, u: np.ndarray, dt: np.ndarray) -> float | None:
        """Fraction of the dissipated energy due to hysteresis, for models that also dissipate by rate; None for others."""
        return None

    def derived(self) -> tuple[Derived, ...]:
        """Quantities that follow from its parameters, which a fit reports with their standard errors."""
        return ()

    def step_errors(self, records: Sequence[Record]) -> AbstractHysteresis:
        """The model with standard errors for the parameters in which its output is piecewise constant; the others are NaN."""
        return jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan), self)

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

        By differentiation of the simulation; override it where the columns are known in closed form.

        Args:
            u: input, shape (T,).
            dt: as in `simulate`.
        """
        solvable = ((0.0, np.inf), (-np.inf, np.inf))  # by one quadratic program
        leaves = [leaf for leaf in leaves_of(self) if leaf.size and leaf.info.linear and leaf.info.bounds in solvable]
        u, dt = (np.asarray(values) for values in checked_drive(self, u, dt))
        # Records of any length share one program where later samples change no output.
        drive = (in_room(u, hold=True), in_room(dt), np.int64(u.size)) if self.causal else (u, dt, None)
        rest, columns = _output_and_jacobian(self, tuple(leaf.index for leaf in leaves), *drive)
        blocks = (
            Block(leaf.index, leaf.info, np.asarray(part).reshape(len(drive[0]), -1)[: u.size])
            for leaf, part in zip(leaves, columns, strict=True)
        )
        return DesignMatrix(tuple(blocks), np.asarray(rest)[: u.size], np.arange(u.size))

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """See the base class: by columns, without a program to compile, where `has_fast_run` and these are not too large."""
        if self.has_fast_run and np.size(u) * sum(leaf.size for leaf in leaves_of(self) if leaf.info.linear) <= COLUMNS:
            return self.design_matrix(*checked_drive(self, u, dt)).output(self)
        return super().free_run(u, dt)

    @property
    def has_rest(self) -> bool:
        """Whether the model can rest before the record on its `level` or on the record's "first" input (see `with_rest`)."""
        return "rest" in self.words

    def with_rest(self, rest: str) -> AbstractHysteresis:
        """The same model, at rest before the record on its "level" or on the record's "first" input."""
        return dataclasses.replace(self, rest=rest) if self.has_rest else self

    @property
    def from_saturation(self) -> bool:
        """Whether every record starts from saturation, so that its input need not turn back (reversal curves)."""
        return False

    def choices(self, records: Sequence[Record]) -> tuple[tuple[AbstractHysteresis, ...], ...]:
        """Models of its kind that a comparison should try on these records, one group for each choice; empty without a choice.

        The first group holds the model itself, with fewer elements where the records cannot determine as many, and others with its
        elements in other places. Each further group differs from the model in one choice: the state before the records, a term, and
        last the number of elements.
        """
        return ()

    def without_creep(self) -> AbstractHysteresis | None:
        """The same model with its creep set to zero; None for a model that has no creep."""
        return None

    # -- optional: control ---------------------------------------------------------------------------------------------------

    def reach(self) -> tuple[float, float] | None:
        """Lowest and highest input for which the model is defined; None where it has no such range."""
        return None

    def inputs_between(self, low: float, high: float) -> tuple[float, float]:
        """Limits of the input for which the output of a filter stays between two values; by default for a static gain of one."""
        return low, high

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """The one-sample inverse: a closed form, or by default a bracketed search.

        Args:
            sign: of a search; -1 for outputs that fall with the input.

        Raises:
            ModelError: the model has no causal inverse (a delay, a resonance, what `no_inverse` says).
        """
        if self.no_inverse:
            raise ModelError(self.no_inverse.format(name=type(self).__name__))
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

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Change of the output by a small step of the input on every branch within a range; None where it is not known.

        By default known of linear filters, whose gain over one sample does not depend on the branch.

        Args:
            low, high: inputs.
            dt: time between samples; None without time.
        """
        if not self.linear_in_input or (dt is None and not self.rate_independent):
            return None
        return Slopes.of(float(_gain(self, np.float64(0.0 if dt is None else dt))))

    def c_part(self) -> CPart:
        """The model's part of the exported C code.

        Raises:
            ModelError: the model has no C code.
        """
        if not self.c_template:
            raise ModelError(
                f"{type(self).__name__} has no C code: give it a method c_part (see hystfit.models.shared.c_code)"
            )
        return CPart.of(self, self.c_template)

    def uniaxial_material(self) -> UniaxialMaterial:
        """The model as a material of OpenSees.

        Raises:
            ModelError: there is no such material, or it lacks a term of the model.
        """
        raise ModelError(f"OpenSees has no uniaxialMaterial like {type(self).__name__}")


class OutputResonance(NamedTuple):
    """A resonance at the end of a model: the model before it (None where there is nothing), omega [rad/s] and zeta."""

    model: AbstractHysteresis | None
    omega: float
    zeta: float


@compiled
def _output_and_jacobian(
    model: Any, at: tuple[int, ...], u: Array, dt: Array, count: Array | None
) -> tuple[Array, list[Array]]:
    """Output with the leaves `at` set to zero, and its derivatives in them."""
    leaves, treedef = jax.tree_util.tree_flatten(model)

    def output(values: list[Array]) -> Array:
        flat = list(leaves)
        for k, value in zip(at, values, strict=True):
            flat[k] = value
        return run(treedef.unflatten(flat), u, dt, count=count)[0]

    zero = [jnp.zeros_like(leaves[k]) for k in at]
    return output(zero), jax.jacfwd(output)(zero) if at else []


@compiled
def _gain(model: Any, dt: Array) -> Array:
    """Change of the output by a step of the input from 0 to 1 in one sample."""
    zero = jnp.zeros(())
    response = lambda u: model.step(model.init(zero), zero, u, dt)[1]
    return response(zero + 1.0) - response(zero)


def check_same_length(model: AbstractHysteresis, one: str, other: str, element: str) -> None:
    """Refuse two arrays of a model that do not have one value for each element, such as a play."""
    first, second = (getattr(getattr(model, name), "shape", None) for name in (one, other))
    if first is None or second is None:  # placeholders of a tree
        return
    if first[-1:] != second[-1:]:
        raise ModelError(f"{one} and {other} must have one value for each {element}, got shapes {first}, {second}")
