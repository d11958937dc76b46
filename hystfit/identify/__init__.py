"""Sequential identifiers: recursive least squares, gradient correction, the unscented filter, and remedies against bias."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.identify.base import AbstractIdentifier as AbstractIdentifier
from hystfit.identify.base import Info as Info
from hystfit.identify.base import Sample as Sample
from hystfit.identify.bias import NoiseBias as NoiseBias
from hystfit.identify.bias import noise_bias as noise_bias
from hystfit.identify.gradient_correction import GradientCorrection as GradientCorrection
from hystfit.identify.identification import Identification as Identification
from hystfit.identify.regressors import DuhemRegressor as DuhemRegressor
from hystfit.identify.remedies import bias_compensated as bias_compensated
from hystfit.identify.remedies import decimate as decimate
from hystfit.identify.remedies import integrated_regression as integrated_regression
from hystfit.identify.remedies import output_error as output_error
from hystfit.identify.rls import Rls as Rls
from hystfit.identify.smoother import smooth as smooth
from hystfit.identify.staged import Phase as Phase
from hystfit.identify.staged import identify_in_stages as identify_in_stages
from hystfit.identify.ukf import Ukf as Ukf
from hystfit.models.duhem import Duhem

IDENTIFIERS: dict[str, Any] = {"rls": Rls, "gradient-correction": GradientCorrection, "ukf": Ukf}


def identify(
    data: Record | Dataset | Sequence[Record],
    method: str = "rls",
    model: Any = None,
    *,
    passes: int = 1,
    **settings: Any,
) -> Identification:
    """Identify a model sample by sample.

    Args:
        data: one record or several, taken one after another.
        method: "rls", "gradient-correction" or "ukf".
        model: gives the orders, the scheme and, with start="model", the start; a `Duhem` of the paper's orders by default.
        passes: over the data.
        **settings: of the identifier, see `Rls.of`, `GradientCorrection.of` and `Ukf.of`.

    Raises:
        HystfitError: an unknown method, a model that it cannot identify, settings or data that cannot be used.
    """
    if method not in IDENTIFIERS:
        raise ParameterError(f"method must be one of {', '.join(IDENTIFIERS)}, got {method!r}")
    model = Duhem() if model is None else model
    known = [name for name in inspect.signature(IDENTIFIERS[method].of).parameters if name not in ("model", "data")]
    unknown = [name for name in settings if name not in known]
    if unknown:
        raise ParameterError(f"method {method!r} has no setting {unknown[0]!r}; it has {', '.join(known)}")
    return IDENTIFIERS[method].of(model, data, **settings).fit(data, passes=passes)
