"""The size against which the error of a parameter is judged."""

from __future__ import annotations

import numpy as np

from hystfit.params.coordinates import BOTH, REAL
from hystfit.params.space import ParameterSpace

REACH = 1.96  # standard errors to either side of a value, within which the truth lies with 95 %
ROUNDED = 1e-8  # relative size below which what is left of a difference is rounding errors
OPEN = 1.0  # standard error over this size, from which a direction or a quantity is undetermined


def relative_size(space: ParameterSpace, x: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """Size against which the error of each parameter at x is judged: its distance to the bounds, or its natural scale without any.

    For an offset it is the natural scale alone, because its value depends on where zero lies. `scale` replaces that of the space.
    """
    lower, upper, kind = space.lower, space.upper, space.kinds
    scale = space.scale if scale is None else scale
    with np.errstate(invalid="ignore"):
        both = (x - lower) * (upper - x) / (upper - lower)
        one = np.where(np.isfinite(lower), x - lower, upper - x)
    natural = np.where(space.offsets, scale, np.maximum(scale, np.abs(x)))
    # A weight that is nearly zero is determined when its error is small compared with its scale, not with its value.
    one = np.where(space.linear, np.maximum(one, scale), one)
    return np.where(kind == REAL, natural, np.where(kind == BOTH, both, one))
