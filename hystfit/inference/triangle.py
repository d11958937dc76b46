"""The triangular factor of tall matrices, in blocks of rows: least squares needs no more of a Jacobian of a million samples."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_ROWS = 2**16  # of a block; shorter matrices are factored at once


def triangle(
    rows: Float[np.ndarray, "n p"], last: Float[np.ndarray, " n"] | None = None, order: np.ndarray | None = None
) -> Float[np.ndarray, "m p2"]:
    """R of rows = Q R, or of [rows, last] = Q R, with at most as many rows as columns.

    Args:
        rows: any matrix.
        last: a further column.
        order: of the columns of `rows`, shape (p,).
    """
    factor = None
    for start in range(0, max(len(rows), 1), _ROWS):
        block = rows[start : start + _ROWS]
        block = block if order is None else block[:, order]
        if last is not None:
            block = np.column_stack([block, last[start : start + _ROWS]])
        factor = np.asarray(np.linalg.qr(block if factor is None else np.vstack([factor, block]), mode="r"))
    assert factor is not None
    return factor
