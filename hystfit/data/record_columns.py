"""The columns of a record: numbers of one length, an input without gaps, time that does not decrease."""

from __future__ import annotations

import numpy as np

from hystfit.data.preparation import real_numbers
from hystfit.errors import DataError


def column(name: str, values: object) -> np.ndarray:
    """A copy of numbers of shape (T,) that cannot be written to, so that later changes of the argument do not reach the record."""
    try:
        array = real_numbers(values)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be numbers: {error}") from error
    if array.ndim != 1:
        raise DataError(f"{name} must be one-dimensional, got shape {array.shape}")
    array.flags.writeable = False
    return array


def check_columns(record: str, u: np.ndarray, y: np.ndarray, t: np.ndarray | None, weight: np.ndarray) -> None:
    """Refuse what no model can be driven through or compared with.

    Args:
        record: its name.
        u, y, t, weight: see `Record`, one-dimensional.
    """
    columns = {"u": u, "y": y, "weight": weight} | ({} if t is None else {"t": t})
    if len({values.size for values in columns.values()}) != 1:
        listed = ", ".join(f"{name} {values.size}" for name, values in columns.items())
        raise DataError(f"record {record!r}: the columns differ in length ({listed})")
    if u.size < 2:
        raise DataError(f"record {record!r} has {u.size} sample(s); a loop needs at least two")
    if not np.isfinite(u).all():
        bad = ~np.isfinite(u)
        raise DataError(
            f"record {record!r}: the input is not finite at {bad.sum()} samples, first at sample {int(np.argmax(bad))}; "
            "a model cannot be driven through a gap: remove those rows or split the record"
        )
    if np.isinf(y).any():
        raise DataError(f"record {record!r}: the output is infinite at {int(np.isinf(y).sum())} samples")
    if np.isnan(y).all():
        raise DataError(f"record {record!r}: the output has no finite value")
    if t is not None and (not np.isfinite(t).all() or (np.diff(t) < 0).any()):
        at = int(np.argmax(~(np.diff(t) >= 0))) + 1
        raise DataError(f"record {record!r}: time is not finite or decreases at sample {at}")
    if not (0 <= weight.min() and weight.max() < np.inf):
        raise DataError(f"record {record!r}: weights must be finite and not negative")
