"""Priors of several parameters that depend on each other: the prior of each, and the correlations of their normal scores."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.errors import ParameterError
from hystfit.inference.priors import AbstractPrior
from hystfit.models.shared.shapes import Scalar


@dataclasses.dataclass(frozen=True)
class CorrelatedPriors(Mapping[str, AbstractPrior]):
    """Priors by parameter, of which some have jointly normal scores (a Gaussian copula); each keeps its own distribution.

    Such as CorrelatedPriors({"c": Normal(1.0, 0.1), "tau": LogNormal(2.0, 0.3)}, [[1, 0.6], [0.6, 1]]). `priors | others` replaces
    priors, which lose their correlations.

    Attributes:
        each: priors by name; correlated ones are normal, log-normal or logit-normal.
        correlation: of the normal scores, shape (k, k).
        names: of the correlated parameters, in the order of the matrix; default: all.

    Raises:
        ParameterError: a correlated prior of another kind; a matrix that is not a correlation matrix of that size.
    """

    each: Mapping[str, AbstractPrior]
    correlation: np.ndarray
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names, matrix = self.names or tuple(self.each), np.asarray(self.correlation, dtype=float)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "correlation", matrix)
        if others := [name for name in names if not getattr(self.each[name], "has_score", False)]:
            raise ParameterError(
                f"correlated priors are normal, log-normal or logit-normal, that of {', '.join(others)} is not"
            )
        shape = (len(names), len(names))
        if matrix.shape != shape or not np.allclose(matrix, matrix.T) or not np.allclose(np.diag(matrix), 1):
            raise ParameterError(
                f"the correlation of {', '.join(names)} must be a symmetric matrix of shape {shape} with ones along its diagonal"
            )
        if np.linalg.eigvalsh(matrix)[0] <= 0:
            raise ParameterError(f"the correlation matrix of {', '.join(names)} is not positive definite")

    def __getitem__(self, name: str) -> AbstractPrior:
        return self.each[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.each)

    def __len__(self) -> int:
        return len(self.each)

    def __or__(self, others: Mapping[str, AbstractPrior]) -> Mapping[str, AbstractPrior]:
        kept = [name for name in self.names if name not in others]
        return self._among({**self.each, **others}, kept)

    def __ror__(self, others: Mapping[str, AbstractPrior]) -> Mapping[str, AbstractPrior]:
        return dataclasses.replace(self, each={**others, **self.each})

    def of(self, names: Collection[str]) -> Mapping[str, AbstractPrior]:
        """Those of some parameters."""
        each = {name: prior for name, prior in self.each.items() if name in names}
        return self._among(each, [name for name in self.names if name in each])

    def _among(self, each: Mapping[str, AbstractPrior], names: Sequence[str]) -> Mapping[str, AbstractPrior]:
        """Priors of which some stay correlated."""
        if len(names) < 2:
            return dict(each)
        at = [self.names.index(name) for name in names]
        return CorrelatedPriors(each, self.correlation[np.ix_(at, at)], tuple(names))


class Dependence(eqx.Module):
    """What correlation of parameters `at` positions adds to the log density of independent priors; `excess`: inverse correlation less I."""

    at: tuple[int, ...] = eqx.field(static=True)
    excess: Float[Array, "k k"]
    half_log_det: Scalar

    @classmethod
    def of(cls, priors: Any, names: Sequence[str]) -> Dependence | None:
        """That of the priors that were given, for parameters with these names; None where they are independent."""
        if not isinstance(priors, CorrelatedPriors):
            return None
        if missing := [name for name in priors.names if name not in names]:
            raise ParameterError(f"correlated priors for {', '.join(missing)}: no free parameter has exactly that name")
        matrix = priors.correlation
        excess = np.linalg.inv(matrix) - np.eye(len(matrix))
        half = 0.5 * float(np.linalg.slogdet(matrix)[1])
        return cls(tuple(list(names).index(name) for name in priors.names), jnp.asarray(excess), jnp.asarray(half))

    def log_density(self, priors: Sequence[AbstractPrior], x: Float[Array, " d"]) -> Scalar:
        """To be added to the sum over `priors` at physical x."""
        scores = jnp.stack([priors[k].score(x[k]) for k in self.at])
        return -0.5 * scores @ self.excess @ scores - self.half_log_det
