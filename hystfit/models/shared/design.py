"""Design matrices: what the linear weights of a model are multiplied by, for a given input."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Float
from scipy.linalg.lapack import dpotri

from hystfit.models.shared.cholesky import cholesky
from hystfit.models.shared.nonnegative import submatrix
from hystfit.params.param import ParamInfo, leaves_of

COLUMNS = 2**24  # numbers in a design matrix (128 MiB) above which programs that scan the samples are used instead
FAR = 100.0  # level of an output, over its range, from which normal equations need it subtracted


@dataclasses.dataclass(frozen=True)
class Penalty:
    """Smoothness of weights that belong to cells of a plane, or to intervals of an axis."""

    matrix: np.ndarray  # of the quadratic penalty, shape (p, p)
    # number of cells that share each weight, shape (p,); None where coverage by the data is not reported
    cells: np.ndarray | None = None
    label: str = ""  # plural name of a cell


@runtime_checkable
class Basis(Protocol):
    """A matrix of shape (q, p) that is multiplied with in less time than its entries take."""

    @property
    def shape(self) -> tuple[int, int]:
        """(q, p)."""
        ...

    def spread(self, values: Float[np.ndarray, "q k"]) -> Float[np.ndarray, "p k"]:
        """basis.T @ values."""
        ...

    def collected(self, weights: Float[np.ndarray, " p"]) -> Float[np.ndarray, " q"]:
        """basis @ weights."""
        ...


@dataclasses.dataclass(frozen=True)
class Factored:
    """Columns as a product of sparse rows, (S, q), and a basis, (q, p), that all inputs share; to NumPy it is that array."""

    rows: scipy.sparse.csr_array
    basis: Basis

    @property
    def shape(self) -> tuple[int, int]:
        """(S, p)."""
        return self.rows.shape[0], self.basis.shape[1]  # type: ignore[index]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.basis.spread(self.rows.T.toarray()).T, dtype)

    def __matmul__(self, weights: np.ndarray) -> np.ndarray:
        return self.rows @ self.basis.collected(weights)

    def __getitem__(self, which: np.ndarray | slice) -> Factored:
        return Factored(self.rows[which], self.basis)

    def transposed_product(self, sides: Float[np.ndarray, "S k"]) -> Float[np.ndarray, "p k"]:
        """columns.T @ sides."""
        return self.basis.spread(self.rows.T @ sides)


Columns = np.ndarray | Factored


@dataclasses.dataclass(frozen=True)
class Block:
    """Columns, shape (S, p), of one array of linear weights, a leaf of the model; with a penalty if they are many and smooth."""

    leaf: int
    info: ParamInfo
    columns: Columns
    penalty: Penalty | None = None


@dataclasses.dataclass(frozen=True)
class DesignMatrix:
    """The output of a model as a function of its linear weights: rest + sum over the blocks of columns @ weights.

    Rows that many samples share are stored once: `rest` has shape (S,), and `index`, the row of each sample, (T,).
    """

    blocks: tuple[Block, ...]
    rest: np.ndarray
    index: np.ndarray

    @classmethod
    def of(cls, model: Any, columns: Mapping[str, np.ndarray]) -> DesignMatrix:
        """The output as these columns alone, (T, p) by the name of the field, a row for each sample."""
        blocks = [
            Block(leaf.index, leaf.info, columns[leaf.path[-1]])
            for leaf in leaves_of(model)
            if leaf.path[-1] in columns
        ]
        count = len(blocks[0].columns)
        return cls(tuple(blocks), np.zeros(count), np.arange(count))

    def output(self, model: Any) -> np.ndarray:
        """The output with the weights of a model, a value for each sample."""
        values = jax.tree_util.tree_leaves(model)
        columns = (block.columns @ np.ravel(values[block.leaf]) for block in self.blocks)
        return sum(columns, start=self.rest)[self.index]

    def rows(self) -> DesignMatrix:
        """The same with one row per sample."""
        blocks = tuple(dataclasses.replace(block, columns=block.columns[self.index]) for block in self.blocks)
        return DesignMatrix(blocks, self.rest[self.index], np.arange(self.index.size))


def effective_number(gram: np.ndarray, penalty: np.ndarray, free: np.ndarray) -> float:
    """Number of weights that the data determine: trace of (A + penalty)^-1 A over those not held at zero; A is their normal matrix."""
    at = np.flatnonzero(free)
    own, total = submatrix(gram, at), submatrix(gram + penalty, at)
    total[np.diag_indices_from(total)] += 1e-12 * np.trace(total) / max(at.size, 1)
    try:
        # The lower triangle of the inverse, in half the time of a solve with all columns.
        inverse, _ = dpotri(cholesky(total), lower=True, overwrite_c=True)
    except np.linalg.LinAlgError:  # positive definite but for rounding
        return float(np.trace(np.linalg.solve(total, own)))
    return float(2 * np.sum(np.tril(inverse, -1) * own) + np.diag(inverse) @ np.diag(own))


def with_own_offsets(A: np.ndarray, b: np.ndarray, weights: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Weights of fits, shape (N, p), with the offsets `own` of records that were left out as a whole at their least-squares values.

    Only the samples left out, of normal equations A, (p, p), and b, (N, p), determine these offsets.
    """
    at = np.flatnonzero(own & (np.diag(A) > 0))
    if not at.size:
        return weights
    weights = weights.copy()
    weights[:, at] += np.linalg.solve(A[np.ix_(at, at)], (b - weights @ A)[:, at].T).T
    return weights
