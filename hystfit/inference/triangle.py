"""The triangular factor of tall matrices, in blocks of rows that stay in the cache: least squares needs no more of a Jacobian."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Entries of a block, and rows for each column at least. Larger blocks would be copied in memory that the system hands out page by
# page, which takes several times as long as their factor.
_ENTRIES, _TALL = 2**13, 8


def triangle(
    rows: Float[np.ndarray, "n p"], last: Float[np.ndarray, " n"] | None = None, order: np.ndarray | None = None
) -> Float[np.ndarray, "m p2"]:
    """R of rows = Q R, or of [rows, last] = Q R, with at most as many rows as columns.

    Args:
        rows: any matrix.
        last: a further column.
        order: of the columns of `rows`, shape (p,).
    """
    factor, columns = None, rows.shape[1] + (last is not None)
    size = max(_ENTRIES // max(columns, 1), _TALL * columns, 1)
    for start in range(0, max(len(rows), 1), size):
        block = rows[start : start + size]
        block = block if order is None else block[:, order]
        if last is not None:
            block = np.column_stack([block, last[start : start + size]])
        factor = np.asarray(np.linalg.qr(block if factor is None else np.vstack([factor, block]), mode="r"))
    assert factor is not None
    return factor
