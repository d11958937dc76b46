"""Linear algebra on long records by blocks of rows or columns: memory holds the result and one block besides the data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dpstrf, dtpqrt

from hystfit.models.shared.cholesky import cholesky
from hystfit.params.host_arrays import NUMBERS

# Entries of a block of `beside`, and rows for each of its columns at least. A larger block is copied into memory that the system hands
# out page by page, which takes longer than its factor.
ENTRIES, TALL = 2**15, 2
_PANEL = 64  # columns that `triangle` eliminates together


def parts(size: int, other: int) -> Iterator[slice]:
    """Slices of an axis of `size` entries, so that a block of them with `other` entries along the other axis has at most `NUMBERS`."""
    width = max(NUMBERS // max(other, 1), 1)
    for begin in range(0, size, width):
        yield slice(begin, min(begin + width, size))


def chosen(rows: np.ndarray, on: np.ndarray) -> np.ndarray:
    """rows[on] for a mask of shape (n,); a view where the mask selects the first rows, as in one padded record."""
    count = int(np.count_nonzero(on))
    return rows[:count] if on[:count].all() else rows[on]


def qr(
    rows: Float[np.ndarray, "n p"], *, overwrite: bool = False
) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "m p"]]:
    """`np.linalg.qr` by blocks of rows (Demmel et al. 2012), m = min(n, p); with `overwrite`, Q may take the place of the rows."""
    n, p = rows.shape
    blocks = _tall(n, p)
    if len(blocks) == 1:
        return np.linalg.qr(rows)
    Q, triangles = rows if overwrite else np.empty((n, p)), []
    for part in blocks:
        Q[part], triangle = np.linalg.qr(rows[part])
        triangles.append(triangle)
    inner, R = np.linalg.qr(np.vstack(triangles))
    for k, part in enumerate(blocks):
        Q[part] = Q[part] @ inner[k * p : (k + 1) * p]
    return Q, R


def _tall(n: int, p: int) -> list[slice]:
    """Blocks of rows with at least as many rows as columns."""
    blocks = list(parts(n, p))
    if len(blocks) > 1 and min(blocks[0].stop, n - blocks[-1].start) < p:
        width = max(blocks[0].stop, 2 * p)
        begins = [begin for begin in range(0, n, width) if n - begin >= p]
        blocks = [slice(a, b) for a, b in zip(begins, [*begins[1:], n], strict=True)]
    return blocks


def triangle(blocks: Iterable[Float[np.ndarray, "_ p"]], size: int) -> Float[np.ndarray, "p p"]:
    """R of a matrix Q R of which blocks of rows come one after another, each eliminated below the factor of those before it.

    The cost is that of one factorization of the whole, however small the blocks are. `size` is p. Least squares needs no more of a
    Jacobian of a million samples.
    """
    factor = np.zeros((size, size), order="F")
    for rows in blocks:
        if len(rows) and size:
            factor = dtpqrt(0, min(_PANEL, size), factor, rows, overwrite_a=True)[0]
    return factor


def gram_root(gram: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """R with R'R = gram, for a normal matrix of any rank.

    Singular values of columns of unit length are known to 1e-8 of the largest one.
    """
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    scaled = gram / size / size[:, None]
    try:
        return np.triu(cholesky(scaled).T) * size
    except np.linalg.LinAlgError:  # singular, to rounding
        factor, order, rank, _ = dpstrf(scaled)
        root = np.zeros_like(factor)
        root[:rank, order - 1] = np.triu(factor)[:rank]
        return root * size


def beside(
    rows: Float[np.ndarray, "n p"], last: Float[np.ndarray, " n"], order: np.ndarray
) -> Iterator[Float[np.ndarray, "m p1"]]:
    """Blocks of rows of [rows[:, order], last], which is never held as a whole."""
    columns = rows.shape[1] + 1
    size = max(ENTRIES // columns, TALL * columns)
    for start in range(0, len(rows), size):
        part = slice(start, start + size)
        yield np.column_stack([rows[part][:, order], last[part]])


def gram(columns: Sequence[np.ndarray], apply: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "k k"]:
    """X' apply(X) without a copy of the columns X; `apply` gets as many of them at once as fit into a block.

    The columns have shapes (n, k_i) or (n,); `apply` gets them in Fortran order, as LAPACK takes them.
    """
    groups = [part[:, None] if part.ndim == 1 else part for part in columns]
    pieces = []
    for group in groups:
        for part in parts(group.shape[1], len(group)):
            applied = apply(np.asfortranarray(group[:, part]))
            pieces.append(np.concatenate([left.T @ applied for left in groups]))
    return np.hstack(pieces)


def spread(columns: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " p"]:
    """Standard deviation of each column, by blocks of rows."""
    n, p = columns.shape
    mean = columns.sum(axis=0) / n
    return np.sqrt(sum(np.sum((columns[part] - mean) ** 2, axis=0) for part in parts(n, p)) / n)
