"""The triangular factor of tall matrices, in blocks of rows: least squares needs no more of a Jacobian of a million samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dtpqrt

_PANEL = 64  # columns that are eliminated together
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


def triangle_of_blocks(blocks: Iterable[Float[np.ndarray, "n p"]], size: int) -> Float[np.ndarray, "p p"]:
    """R of a matrix Q R of which blocks of rows come one after another, each eliminated below the factor of those before it.

    The cost is that of one factorization of the whole, however small the blocks are.

    Args:
        blocks: of rows.
        size: p, number of their columns.
    """
    factor = np.zeros((size, size), order="F")
    for rows in blocks:
        if len(rows) and size:
            factor = dtpqrt(0, min(_PANEL, size), factor, rows, overwrite_a=True)[0]
    return factor
