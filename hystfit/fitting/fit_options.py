"""Options of a fit, with their defaults: `hystfit.fit`, the fits of a comparison and those of a batch have the same."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from hystfit.config import require_seed
from hystfit.errors import ParameterError
from hystfit.fitting.solvers.estimate import AbstractEstimator
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.objective import Loss
from hystfit.inference.problem import LOSSES

Start = Literal["data", "model"] | Mapping[str, float]
OF_SEARCH = ("starts", "noise")  # options besides the seed that have a meaning for every model
_PLAIN_NOISE = ("auto", "iid")  # the others have a likelihood of their own, in which outliers may have a place


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """How one model is fitted; `hystfit.fit` describes each option."""

    method: str | AbstractEstimator = "auto"
    fix: Sequence[str] | Mapping[str, Any] = ()
    free: Sequence[str] = ()
    start: Start = "data"
    starts: int = 8
    seed: int = 0
    loss: Loss = "linear"
    noise: str | type[AbstractNoise] = "auto"
    covariates: Mapping[str, str | Sequence[str]] | Sequence[str] = ()
    tie: Mapping[str, str] | None = None
    spacing: int = 1  # set by a comparison: samples over which the errors of its models are correlated

    @property
    def plain_noise(self) -> bool:
        """Whether no noise model refines the fit."""
        return self.noise in _PLAIN_NOISE

    def of_fit(self) -> dict[str, Any]:
        """The arguments of `hystfit.fit`; the spacing, which a comparison sets, is none of them."""
        return {name: value for name, value in vars(self).items() if name != "spacing"}

    def changed(self) -> list[str]:
        """Names of the options that have another value than their default; the seed, which every fit takes, is none of them."""
        names = [name for name in self.of_fit() if name != "seed"]
        return [name for name in names if (getattr(self, name) or None) != (getattr(type(self), name) or None)]

    def check_search(self, others: Iterable[str] = ()) -> None:
        """Refuse options, and others that were given, that belong to one model where the model itself is searched for ("auto")."""
        self.check()
        if refused := [*(name for name in self.changed() if name not in OF_SEARCH), *others]:
            accepted = ", ".join(f"{name}=" for name in OF_SEARCH)
            raise ParameterError(
                f"{refused[0]}= needs an explicit model, such as model='bouc-wen' (compare ranks the models); without one, fit takes "
                f"{accepted} and seed= only"
            )

    def check(self) -> None:
        """Refuse options that no data can be fitted with.

        Raises:
            HystfitError: one of them is unknown, or has a value that it cannot have.
        """
        require_seed(self.seed)
        if self.method != "auto" and not isinstance(self.method, AbstractEstimator):
            ESTIMATORS.find(self.method)
        if self.noise != "auto":
            NOISES.find(self.noise)
        if self.loss not in LOSSES:
            raise ParameterError(f"loss must be one of {', '.join(LOSSES)}, got {self.loss!r}")
        if self.start not in ("data", "model") and not isinstance(self.start, Mapping):
            raise ParameterError(f"start must be data, model, or values of parameters by name, got {self.start!r}")
        if self.starts < 1:
            raise ParameterError(f"at least one start is needed, got {self.starts}")


DEFAULT_OPTIONS = FitOptions()
