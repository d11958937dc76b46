"""Priors of parameters in physical units: the user's own, or defaults from declarations and bounds."""

from __future__ import annotations

import abc
import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.errors import ParameterError
from hystfit.models.shared.shapes import Scalar
from hystfit.params.coordinates import BOTH, LOWER, REAL
from hystfit.params.space import ParameterSpace

WIDE = 10.0  # standard deviation of an unbounded parameter's prior, in its natural size
# Standard deviation of the logarithm of a positive parameter over its natural size: a factor of 20 either way.
LOG_WIDE = 3.0
_INSIDE = 0.01  # of the natural size, by which a value on its bound is moved off it
LITTLE = 0.5  # width of a posterior over that of its prior, above which the data add little
SEEN = 2000  # draws of a prior, to see where it lies
_NUMBERS = ("mean", "sd", "median", "spread", "edge", "lower", "upper")
_LOG_ROOT = float(0.5 * np.log(2 * np.pi))


def _number(value: Any) -> Array:
    return jnp.asarray(value, dtype=jnp.result_type(float))


class AbstractPrior(eqx.Module):
    """A density over one parameter.

    Class attributes:
        has_score: whether a transformed parameter is normal, see `score`.
    """

    has_score: ClassVar[bool] = False

    def exact(self) -> list[Any]:
        """Kind and fields in full precision, which identify the prior."""
        return [
            type(self).__name__,
            *(np.asarray(getattr(self, field.name)).tolist() for field in dataclasses.fields(self)),
        ]

    @abc.abstractmethod
    def log_density(self, x: Scalar) -> Scalar:
        """Log density at x; minus infinity outside the support."""

    def score(self, x: Scalar) -> Scalar:
        """The normal score of x, which is standard normal under the prior, where `has_score` is set."""
        raise TypeError(f"{type(self).__name__} has no normal score")

    def moved(self, shift: float, factor: float) -> AbstractPrior:
        """The prior whose normal scores are `shift` larger in the mean and `factor` times as wide, where `has_score` is set."""
        raise TypeError(f"{type(self).__name__} has no normal score")

    @abc.abstractmethod
    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        """Independent draws."""

    def quantiles(self, levels: Sequence[float]) -> Float[np.ndarray, " k"]:
        """Quantiles at these levels, from draws with a constant seed."""
        return np.quantile(np.asarray(self.sample(jax.random.key(0), (SEEN,))), levels)


class Normal(AbstractPrior):
    """Gaussian. Raises ParameterError for a standard deviation that is not positive."""

    has_score: ClassVar[bool] = True
    mean: Array = eqx.field(converter=_number)
    sd: Array = eqx.field(converter=_number)

    def log_density(self, x: Scalar) -> Scalar:
        return -0.5 * self.score(x) ** 2 - jnp.log(self.sd) - _LOG_ROOT

    def score(self, x: Scalar) -> Scalar:
        return (x - self.mean) / self.sd

    def moved(self, shift: float, factor: float) -> Normal:
        return Normal(self.mean + shift * self.sd, self.sd * factor)

    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        return self.mean + self.sd * jax.random.normal(key, shape)

    def __str__(self) -> str:
        return f"normal, mean {float(self.mean):.3g}, sd {float(self.sd):.3g}"


class LogNormal(AbstractPrior):
    """side * (x - edge) is log-normal with this median; `spread` is the standard deviation of the logarithm."""

    has_score: ClassVar[bool] = True
    median: Array = eqx.field(converter=_number)
    spread: Array = eqx.field(converter=_number)
    edge: Array = eqx.field(converter=_number, default=0.0)
    side: float = eqx.field(static=True, default=1.0)

    def log_density(self, x: Scalar) -> Scalar:
        above = self.side * (x - self.edge)
        rest = jnp.log(self.spread) + _LOG_ROOT + jnp.log(jnp.where(above > 0, above, 1.0))
        return jnp.where(above > 0, -0.5 * self.score(x) ** 2 - rest, -jnp.inf)

    def score(self, x: Scalar) -> Scalar:
        above = self.side * (x - self.edge)
        return (jnp.log(jnp.where(above > 0, above, 1.0)) - jnp.log(self.median)) / self.spread

    def moved(self, shift: float, factor: float) -> LogNormal:
        median = self.median * jnp.exp(shift * self.spread)
        return LogNormal(median, self.spread * factor, self.edge, self.side)

    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        return self.edge + self.side * self.median * jnp.exp(self.spread * jax.random.normal(key, shape))

    def __str__(self) -> str:
        away = "" if float(self.edge) == 0 and self.side > 0 else f" from {float(self.edge):.3g}"
        return f"log-normal{away}, median {float(self.median):.3g}, within a factor {float(jnp.exp(self.spread)):.3g} (1 sd)"


class HalfNormal(AbstractPrior):
    """Gaussian about its edge, on one side of it: a weight that may be zero."""

    sd: Array = eqx.field(converter=_number)
    edge: Array = eqx.field(converter=_number, default=0.0)
    side: float = eqx.field(static=True, default=1.0)

    def log_density(self, x: Scalar) -> Scalar:
        t = self.side * (x - self.edge) / self.sd
        return jnp.where(t >= 0, -0.5 * t**2 + jnp.log(2.0) - jnp.log(self.sd) - _LOG_ROOT, -jnp.inf)

    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        return self.edge + self.side * self.sd * jnp.abs(jax.random.normal(key, shape))

    def __str__(self) -> str:
        return f"half-normal from {float(self.edge):.3g}, sd {float(self.sd):.3g}"


class Uniform(AbstractPrior):
    """Constant between two limits."""

    lower: Array = eqx.field(converter=_number)
    upper: Array = eqx.field(converter=_number)

    def log_density(self, x: Scalar) -> Scalar:
        inside = (x >= self.lower) & (x <= self.upper)
        return jnp.where(inside, -jnp.log(self.upper - self.lower), -jnp.inf)

    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        return self.lower + (self.upper - self.lower) * jax.random.uniform(key, shape)

    def __str__(self) -> str:
        return f"uniform, {float(self.lower):.3g} to {float(self.upper):.3g}"


class LogitNormal(AbstractPrior):
    """Between two limits, the logit of the place between them Gaussian about that of `median`; `spread` is its standard deviation."""

    has_score: ClassVar[bool] = True
    lower: Array = eqx.field(converter=_number)
    upper: Array = eqx.field(converter=_number)
    median: Array = eqx.field(converter=_number)
    spread: Array = eqx.field(converter=_number)

    def _logit(self, x: Array) -> Array:
        return jnp.log(x - self.lower) - jnp.log(self.upper - x)

    def log_density(self, x: Scalar) -> Scalar:
        inside, safe = self._inside(x)
        slope = jnp.log((self.upper - self.lower) / ((safe - self.lower) * (self.upper - safe)))
        return jnp.where(inside, -0.5 * self.score(x) ** 2 - jnp.log(self.spread) - _LOG_ROOT + slope, -jnp.inf)

    def score(self, x: Scalar) -> Scalar:
        return (self._logit(self._inside(x)[1]) - self._logit(self.median)) / self.spread

    def moved(self, shift: float, factor: float) -> LogitNormal:
        share = jax.nn.sigmoid(self._logit(self.median) + shift * self.spread)
        median = self.lower + (self.upper - self.lower) * share
        return LogitNormal(self.lower, self.upper, median, self.spread * factor)

    def _inside(self, x: Scalar) -> tuple[Array, Array]:
        """Whether x lies between the limits, and a value that does."""
        inside = (x > self.lower) & (x < self.upper)
        return inside, jnp.where(inside, x, self.median)

    def sample(self, key: Array, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
        at = self._logit(self.median) + self.spread * jax.random.normal(key, shape)
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(at)

    def __str__(self) -> str:
        limits = f"{float(self.lower):.3g} to {float(self.upper):.3g}"
        return f"logit-normal, {limits}, median {float(self.median):.3g}, spread {float(self.spread):.3g}"


_KINDS = {"normal": Normal, "log-normal": LogNormal, "half-normal": HalfNormal, "uniform": Uniform}


def parse(text: str) -> AbstractPrior:
    """A prior from text: normal(mean, sd), log-normal(median, spread), half-normal(sd), uniform(lower, upper)."""
    match = re.fullmatch(r"\s*([a-z-]+)\s*\(([^()]*)\)\s*", text)
    try:
        return _KINDS[match[1]](*(float(part) for part in match[2].split(",")))  # type: ignore[index]
    except (KeyError, TypeError, ValueError) as error:
        known = "normal(mean,sd), log-normal(median,spread), half-normal(sd), uniform(lower,upper)"
        raise ParameterError(f"a prior is one of {known}; got {text!r}") from error


def priors_around(space: ParameterSpace, x: np.ndarray, spread: float = 0.2) -> dict[str, AbstractPrior]:
    """Priors about physical values x, (p,), with a relative `spread` in the distance to a bound or in the natural size.

    A value on a bound (a play's weight of zero) is first moved inside, by a hundredth of the natural size or of the interval.
    """
    lower, upper, scale = space.lower, space.upper, space.scale
    priors: dict[str, AbstractPrior] = {}
    for k, (name, kind) in enumerate(zip(space.names, space.kinds, strict=True)):
        if kind == REAL:
            priors[name] = Normal(x[k], spread * max(0.1 * scale[k], abs(float(x[k]))))
        elif kind == BOTH:
            away = _INSIDE * (upper[k] - lower[k])
            priors[name] = LogitNormal(lower[k], upper[k], np.clip(x[k], lower[k] + away, upper[k] - away), 2 * spread)
        else:
            edge, side = (lower[k], 1.0) if kind == LOWER else (upper[k], -1.0)
            distance = side * (x[k] - edge)
            priors[name] = LogNormal(distance if distance > 0 else _INSIDE * scale[k], spread, edge, side)
    return priors


def default_priors(space: ParameterSpace, x: np.ndarray | None = None) -> dict[str, AbstractPrior]:
    """Weak priors from the declarations: about the natural size for positive parameters, wide normal without bounds, uniform between two.

    A linear weight with one bound has a half-normal prior on its contribution to the output, the weight times the largest output of its
    element (`effect` in `param`). A stop that yields at the fraction r of the input range gives at most r: the standard deviation of
    its weight is that of a play over r, so that each stop alone may give half the range of the output.

    Fitted values x, shape (p,), widen the prior of an unbounded parameter far from zero, such as the offset of a distant sensor.
    """
    lower, upper, scale = space.lower, space.upper, space.scale
    effect = np.where(space.effect > 0, space.effect, 1.0)
    priors: dict[str, AbstractPrior] = {}
    for k, (name, info, kind) in enumerate(zip(space.names, space.infos, space.kinds, strict=True)):
        if kind == REAL:
            size = scale[k] if x is None else max(scale[k], abs(float(x[k])))
            priors[name] = Normal(0.0, WIDE * size)
        elif kind == BOTH:
            priors[name] = Uniform(lower[k], upper[k])
        else:
            edge, side = (lower[k], 1.0) if kind == LOWER else (upper[k], -1.0)
            weight = HalfNormal(WIDE * scale[k] / effect[k], edge, side)
            priors[name] = weight if info.linear else LogNormal(scale[k], LOG_WIDE, edge, side)
    return priors


def choose_priors(
    space: ParameterSpace,
    given: Mapping[str, AbstractPrior] | None,
    x: np.ndarray | None = None,
    others: Sequence[str] = (),
) -> tuple[AbstractPrior, ...]:
    """Default priors about `x`, replaced by the user's where given, in the order of the space; `others` are more names for a message.

    A given name without a record, such as "offset", stands for that parameter in every record.
    """
    chosen = default_priors(space, x)
    for name, prior in (given or {}).items():
        hits = [known for known in space.names if known == name or known.split("@")[0] == name]
        if not hits:
            raise ParameterError(
                f"a prior for {name!r}, which is not a free parameter; those are: {', '.join([*space.names, *others])}"
            )
        _check(name, prior)
        bounds = {space.infos[space.names.index(hit)].bounds for hit in hits}
        for low, high in bounds:
            drawn = np.asarray(prior.sample(jax.random.key(0), (SEEN,)))
            if not np.any((drawn >= low) & (drawn <= high)):
                raise ParameterError(
                    f"the prior of {name!r} ({prior}) lies outside the parameter's bounds, {low:g} to {high:g}"
                )
        chosen.update(dict.fromkeys(hits, prior))
    return tuple(chosen[name] for name in space.names)


def _check(name: str, prior: Any) -> None:
    """Refuse anything but a proper prior."""
    if not isinstance(prior, AbstractPrior):
        raise ParameterError(
            f"the prior of {name!r} must be one of hystfit.inference.priors, got {type(prior).__name__}"
        )
    values = {f: float(getattr(prior, f)) for f in _NUMBERS if hasattr(prior, f)}
    if bad := [f"{f} = {value}" for f, value in values.items() if np.isnan(value)]:
        raise ParameterError(f"the prior of {name!r}: {', '.join(bad)} is not a number")
    if "upper" in values and values["upper"] < values["lower"]:
        raise ParameterError(f"the prior of {name!r} ({prior}): its lower limit must be below the upper one")
    positive = ("sd", "spread") if isinstance(prior, LogitNormal) else ("sd", "spread", "median")
    widths = [values[f] for f in positive if f in values]
    widths += [values["upper"] - values["lower"]] if "upper" in values else []
    if not all(np.isfinite(width) and width > 0 for width in widths) or not np.isfinite(values.get("mean", 0.0)):
        raise ParameterError(
            f"the prior of {name!r} ({prior}) is flat or has no width: posterior draws need a proper prior"
        )
