"""`identify`: from data and the name of an identifier to an identification."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.identification import Identification
from hystfit.identify.registry import IDENTIFIERS
from hystfit.models.duhem import Duhem


@verb
def identify(
    data: Record | Dataset | Sequence[Record],
    method: Any = "rls",
    model: Any = None,
    *,
    passes: int = 1,
    **settings: Any,
) -> Identification:
    """Identify a model sample by sample.

    Args:
        data: one record or several, run one after another.
        method: name of an identifier ("rls", "gradient-correction", "ukf"), my_file.py:MyIdentifier, or a class.
        model: gives the orders, the scheme and, with start="model", the starting values; a `Duhem` with f of order 3 and g
            of order 2 by default.
        passes: number of runs over the data.
        **settings: of the identifier, see `Rls.of`, `GradientCorrection.of` and `Ukf.of`.

    Raises:
        HystfitError: an unknown method or setting, a model that the method cannot identify, or unusable data.
    """
    identifier = IDENTIFIERS.find(method)
    known = [name for name in inspect.signature(identifier.of).parameters if name not in ("model", "data")]
    unknown = [name for name in settings if name not in known]
    if unknown:
        raise ParameterError(f"method {method!r} has no setting {unknown[0]!r}; it has {', '.join(known) or 'none'}")
    data = Dataset.of(data)
    return identifier.of(Duhem() if model is None else model, data, **settings).fit(data, passes=passes)
