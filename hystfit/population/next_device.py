"""The distribution of a further device: priors for its fit, which follow the covariates that it states."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from hystfit.errors import ParameterError
from hystfit.inference.correlated_priors import CorrelatedPriors


@dataclasses.dataclass(frozen=True)
class NextDevice:
    """What a population says of a further device, in normal scores of the priors at the means of its covariates.

    Attributes:
        at_means: priors at these means.
        means: of the covariates, by name.
        effects: change of the mean scores with each covariate, per unit of it, shape (q, p).
        covariance: of the mean scores and these changes, shape (1 + q, p, 1 + q, p).
    """

    at_means: CorrelatedPriors
    means: Mapping[str, float]
    effects: Float[np.ndarray, "q p"]
    covariance: Float[np.ndarray, "q1 p q1 p"]

    def priors(self, covariates: Mapping[str, float]) -> CorrelatedPriors:
        """Priors of a device with these covariates, by default the means.

        Raises:
            ParameterError: an unknown covariate.
        """
        row = away(self.means, covariates)
        shift = row[1:] @ self.effects
        known = np.einsum("i,ipjk,j->pk", row, self.covariance, row) - self.covariance[0, :, 0]
        spread = self.at_means.correlation + known
        factor = np.sqrt(np.diag(spread))
        moved = zip(self.at_means.items(), shift.tolist(), factor.tolist(), strict=True)
        each = {name: prior.moved(by, wider) for (name, prior), by, wider in moved}
        return CorrelatedPriors(each, spread / np.outer(factor, factor))

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`, from which `hystfit.population.population_files` reads it."""
        return {
            "priors": {name: {"prior": prior.exact()} for name, prior in self.at_means.items()},
            "correlation": self.at_means.correlation.tolist(),
            "covariates": dict(self.means),
            "effects": self.effects.tolist(),
            "covariance": self.covariance.tolist(),
        }


def away(means: Mapping[str, float], covariates: Mapping[str, float]) -> Float[np.ndarray, " q1"]:
    """A one, and covariates less their means, by default zero; unknown ones are refused."""
    if unknown := [name for name in covariates if name not in means]:
        raise ParameterError(f"no covariate {unknown[0]!r}; there are {', '.join(means) or 'none'}")
    return np.array([1.0, *(covariates.get(name, mean) - mean for name, mean in means.items())])
