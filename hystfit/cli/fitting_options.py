"""Options of the verbs that fit: one loop, many, those of a map, or of the devices of a population."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from cyclopts import Parameter

from hystfit.cli.options import lists, named_values, tied_values
from hystfit.inference.noise.registry import NOISES


@lists(noises=NOISES)
@Parameter(name="*")
@dataclass(frozen=True)
class Fitting:
    """Options of every fit.

    Args:
        fix: parameter that is not fitted, as NAME or NAME=VALUE; repeatable.
        free: parameter to fit that the model fixes by default; repeatable.
        tie: parameter that follows from another one, as NAME=NUMBER*NAME+NUMBER ("k2=2*k1", "gamma[1]=gamma[0]"); repeatable.
        noise: auto, {noises}, or my_file.py:MyNoise. auto widens the standard errors where the residuals are autocorrelated, iid
            does not; the other noise models refine the fit by their likelihood.
        starts: number of starting points.
        seed: random seed for the starting points.
    """

    fix: list[str] | None = None
    free: list[str] | None = None
    tie: list[str] | None = None
    noise: str = "auto"
    starts: int = 8
    seed: int = 0

    def keywords(self) -> dict[str, Any]:
        """Arguments of `hystfit.fit`."""
        chosen = {"fix": named_values(self.fix or []), "free": self.free or [], "tie": tied_values(self.tie or [])}
        return vars(self) | chosen


@Parameter(name="*")
@dataclass(frozen=True)
class LoopFitting(Fitting):
    """Options of a fit to loops that share no parameter.

    Args:
        loss: linear, or a robust loss that reduces the influence of outliers: huber, soft-l1, cauchy.
        start: starting values estimated from the data, or those of the model.
    """

    loss: str = "linear"
    start: Literal["data", "model"] = "data"


FITTING, LOOP_FITTING = Fitting(), LoopFitting()
