"""A model whose parameters depend linearly on covariates of the records (temperature, current, preload, frequency)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.covariates import covariate, covariate_unit
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.composition import AbstractComposition
from hystfit.models.shared.design import Block, DesignMatrix
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Code, Note
from hystfit.params.host_arrays import to_device
from hystfit.params.param import ParamInfo, as_array, leaves_of, param
from hystfit.params.space import ParameterSpace

_INSIDE = 1e-6  # of the distance from a parameter to its bound, within which a slope cannot carry it
_BEYOND = 0.005  # of the range fitted, from which a value lies outside


def beyond_range(values: np.ndarray, low: Any, high: Any) -> np.ndarray:
    """Which values lie outside a range that was fitted, by more than rounding."""
    return np.abs(values - 0.5 * (low + high)) > (0.5 + _BEYOND) * (high - low)


def _declared(slope: Slope) -> tuple[str, ParamInfo]:
    """Name and declaration of a slope: its natural size changes the parameter by its own over half the range of the covariate."""
    known = isinstance(slope.half, jax.Array | np.ndarray) and not isinstance(slope.half, jax.core.Tracer)
    unit = covariate_unit(slope.covariate)
    return f"{slope.parameter.replace('.', '_')}/{slope.covariate}", ParamInfo(
        unit=f"{slope.unit}/[{unit}]",
        scale=slope.scale / float(np.asarray(slope.half)) if known else slope.scale,
        doc=f"change of {slope.parameter} by {unit if unit != slope.covariate else f'unit of {unit}'}",
        linear=slope.linear,
    )


class Slope(eqx.Module):
    """Dependence of one parameter on one covariate."""

    value: Array = param(0.0, declared=_declared)  # its slope, of the shape of the parameter
    half: Scalar = eqx.field(converter=as_array, default=1.0)  # half of the range of the covariate in the records
    parameter: str = eqx.field(static=True, default="")  # parameter, covariate: their names
    covariate: str = eqx.field(static=True, default="")
    leaf: int = eqx.field(static=True, default=0)  # number of the parameter among the leaves of the model
    which: int = eqx.field(static=True, default=0)  # number of the covariate
    # lower, upper, unit, scale, linear: as the parameter declares them
    lower: float | None = eqx.field(static=True, default=None)
    upper: float | None = eqx.field(static=True, default=None)
    unit: str = eqx.field(static=True, default="1")
    scale: float = eqx.field(static=True, default=1.0)
    linear: bool = eqx.field(static=True, default=False)


def _at_covariates(name: str) -> Any:
    """A method of the base class: that of the model at the covariates."""

    def method(self: Varying, *args: Any, **options: Any) -> Any:
        return getattr(self.resolved(), name)(*args, **options)

    method.__name__, method.__doc__ = name, "As the model at the covariates."
    return method


def _of_model(name: str) -> Any:
    return property(lambda self: getattr(self.model, name), doc="As the model.")


class Varying(AbstractComposition):
    """A model of which some parameters are linear in covariates:  p = p0 + sum over j of slope_j (c_j - reference_j).

    The reference is the mean of the covariates of the records, so that p0 and the slopes are estimated independently. A parameter stays
    within its bounds. `at` holds the covariates where the model is used: a fit sets them for each record.
    """

    parts: tuple[AbstractHysteresis, ...]  # the model, with its parameters at the reference
    slopes: tuple[Slope, ...]  # dependences
    at: Float[Array, " K"] = eqx.field(converter=as_array)  # covariates, shape (K,)
    reference: Float[Array, " K"] = eqx.field(converter=as_array)  # where the parameters of `model` hold, shape (K,)
    # smallest and largest covariate of the records, shape (2, K)
    edges: Float[Array, "2 K"] = eqx.field(converter=as_array)
    names: tuple[str, ...] = eqx.field(static=True)  # of the covariates

    @classmethod
    def of(cls, model: AbstractHysteresis, pairs: Sequence[tuple[str, str]], records: Sequence[Record]) -> Varying:
        """The model with its parameters at the mean of the covariates, and slopes of zero; `pairs` are (covariate, parameter)."""
        names = tuple(dict.fromkeys(name for name, _ in pairs))
        values = np.array([[covariate(record, name) for name in names] for record in records])
        _check_spread(names, values)
        edges = np.stack([values.min(axis=0), values.max(axis=0)])
        space = ParameterSpace.of(model)
        slopes = tuple(_slope(model, space, name, one, names.index(name), edges) for name, one in pairs)
        return cls((model,), slopes, values[0], values.mean(axis=0), edges, names)

    one_scan = _of_model("one_scan")
    needs = _of_model("needs")
    degrades = _of_model("degrades")
    init = _at_covariates("init")
    step = _at_covariates("step")
    sweep = _at_covariates("sweep")
    free_run = _at_covariates("free_run")
    advice = _at_covariates("advice")
    plays = _at_covariates("plays")
    plane = _at_covariates("plane")
    hysteretic_share = _at_covariates("hysteretic_share")
    slope_range = _at_covariates("slope_range")
    reach = _at_covariates("reach")
    inputs_between = _at_covariates("inputs_between")
    step_inverse = _at_covariates("step_inverse")
    output_resonance = _at_covariates("output_resonance")
    c_part = _at_covariates("c_part")
    uniaxial_material = _at_covariates("uniaxial_material")

    @property
    def model(self) -> AbstractHysteresis:
        """The model at the reference."""
        return self.parts[0]

    def __repr__(self) -> str:
        listed = ", ".join(f"{slope.parameter} of {slope.covariate}" for slope in self.slopes)
        return f"{type(self).__name__}({self.model!r}, {listed})"

    @property
    def covariates(self) -> tuple[str, ...]:
        return self.names

    # -- covariates --------------------------------------------------------------------------------------------------------

    def of_record(self, record: Record) -> Varying:
        """At the covariates of a record."""
        return dataclasses.replace(self, at=np.array([covariate(record, name) for name in self.names]))

    def outside(self) -> list[str]:
        """Covariates beyond those of the records fitted, in words."""
        low, high = np.asarray(self.edges)
        values = np.asarray(self.at)
        rows = zip(self.names, values, low, high, beyond_range(values, low, high), strict=True)
        return [f"{name} = {at:g} lies outside the fitted {a:g} to {b:g}" for name, at, a, b, beyond in rows if beyond]

    def notes(self, records: Sequence[Record]) -> list[Note]:
        """Where engineering quantities hold, and what the covariates of the records cannot show."""
        first = ", ".join(f"{name} = {value:g}" for name, value in zip(self.names, np.asarray(self.at), strict=True))
        notes = [Note(Code.CHOICE, f"quantities of the loop are those at {first}, as of record {records[0].name!r}")]
        for which, name in enumerate(self.names):
            values = {covariate(record, name) for record in records}
            if len(values) == 2:
                varying = ", ".join(slope.parameter for slope in self.slopes if slope.which == which)
                text = f"{name} has only two values, which do not test whether {varying} is linear in it: add a third value"
                notes.append(Note(Code.MODEL_ADVICE, text))
        return notes

    def resolved(self) -> AbstractHysteresis:
        """The model with its parameters at the covariates."""
        leaves, structure = jax.tree_util.tree_flatten(self.model)
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(self))
        xp: Any = jnp if traced else np
        away = xp.asarray(self.at) - xp.asarray(self.reference)
        for leaf in dict.fromkeys(slope.leaf for slope in self.slopes):
            mine = [slope for slope in self.slopes if slope.leaf == leaf]
            base = xp.asarray(leaves[leaf])
            value = base + sum(xp.asarray(slope.value) * away[slope.which] for slope in mine)
            if mine[0].lower is not None and not mine[0].linear:
                value = xp.maximum(value, base - (1.0 - _INSIDE) * (base - mine[0].lower))
            if mine[0].upper is not None and not mine[0].linear:
                value = xp.minimum(value, base + (1.0 - _INSIDE) * (mine[0].upper - base))
            leaves[leaf] = value if traced else to_device(value, float)
        return structure.unflatten(leaves)

    def derived(self) -> tuple[Derived, ...]:
        """Those of the model, and the varying parameters at the ends of the covariates' range."""
        inner = [one._replace(value=lambda m, f=one.value: f(m.resolved())) for one in self.model.derived()]
        for slope in self.slopes:
            if not np.ndim(slope.value):
                inner += [_at_end(self, slope, float(edge[slope.which])) for edge in np.asarray(self.edges)]
        return tuple(inner)

    # -- fitting -----------------------------------------------------------------------------------------------------------

    def start(self, records: Sequence[Record]) -> Varying:
        """Starting values of the model, without dependences."""
        return dataclasses.replace(self, parts=(self.model.start(records),))

    def starting_points(self, records: Sequence[Record]) -> tuple[Varying, ...]:
        """Those of the model, without dependences."""
        return tuple(dataclasses.replace(self, parts=(model,)) for model in self.model.starting_points(records))

    def with_rest(self, rest: str) -> Varying:
        return dataclasses.replace(self, parts=(self.model.with_rest(rest),))

    def without_creep(self) -> Varying | None:
        still = self.model.without_creep()
        return None if still is None else dataclasses.replace(self, parts=(still,))

    def choices(self, records: Sequence[Record]) -> tuple[tuple[AbstractHysteresis, ...], ...]:
        """None: another choice has other parameters."""
        return ()

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of the model, and for the slope of a linear parameter those times the distance from the reference."""
        design = self.resolved().design_matrix(u, dt)
        columns = {block.leaf: block.columns for block in design.blocks}
        away = np.asarray(self.at) - np.asarray(self.reference)
        values = {leaf.path[1]: leaf for leaf in leaves_of(self) if leaf.path[0] == "slopes"}
        blocks = list(design.blocks)
        for slope, leaf in zip(self.slopes, values.values(), strict=True):
            if slope.linear and slope.leaf in columns:
                blocks.append(Block(leaf.index, leaf.info, columns[slope.leaf] * away[slope.which]))
        return dataclasses.replace(design, blocks=tuple(blocks))


def _check_spread(names: Sequence[str], values: np.ndarray) -> None:
    """Refuse covariates that do not determine slopes; values have shape (R, K)."""
    for name, row in zip(names, values.T, strict=True):
        if np.ptp(row) == 0:
            raise DataError(
                f"{name} is {row[0]:g} in every record: no dependence on it can be fitted; add records at another {name}, or leave it out"
            )
    centered = (values - values.mean(axis=0)) / np.ptp(values, axis=0)
    if np.linalg.matrix_rank(centered, tol=1e-6) < len(names):
        raise DataError(
            f"{' and '.join(names)} change together over {len(values)} records, so that their effects cannot be separated: add records in "
            "which one of them alone is different, or leave one out"
        )


def _slope(
    model: AbstractHysteresis, space: ParameterSpace, name: str, parameter: str, which: int, edges: np.ndarray
) -> Slope:
    """A slope of zero of a parameter."""
    number, positions = space.named.find(parameter)
    leaf = space.leaves[number]
    if len(positions) < leaf.size:
        raise ParameterError(
            f"only a whole parameter can depend on a covariate: give {leaf.path[-1]!r}, not {parameter!r}"
        )
    if leaf.info.per_record:
        raise ParameterError(
            f"{parameter!r} has a value for each record, which may be any function of {name}: leave its dependence out"
        )
    if model.estimator == "preisach" and leaf.info.linear:
        raise ModelError(f"the weights {parameter!r} of a Preisach model cannot depend on {name}")
    low, high = leaf.info.bounds
    return Slope(
        value=np.zeros(leaf.shape),
        half=0.5 * (edges[1] - edges[0])[which],
        parameter=parameter,
        covariate=name,
        leaf=leaf.index,
        which=which,
        lower=low if np.isfinite(low) else None,
        upper=high if np.isfinite(high) else None,
        unit=leaf.info.unit,
        scale=leaf.info.scale,
        linear=leaf.info.linear,
    )


def _at_end(model: Varying, slope: Slope, value: float) -> Derived:
    """A parameter of one number at a value of its covariate, the others at their reference."""
    k = next(k for k, one in enumerate(model.slopes) if one is slope)

    def of(varying: Any) -> Array:
        base = jax.tree_util.tree_leaves(varying.model)[slope.leaf]
        return base + varying.slopes[k].value * (value - varying.reference[slope.which])

    name = f"{slope.parameter}({slope.covariate}={value:g})"
    return Derived(name, slope.unit, f"{slope.parameter} where {slope.covariate} is {value:g}", of)
