"""A misfit and its derivatives, block after block of samples: hundreds of weights would fill the memory with the derivatives of all."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Bool, Float

from hystfit.inference.blocks import beside, chosen, gram_root, parts, triangle


@dataclasses.dataclass(frozen=True)
class Linearization:
    """A misfit at one point of parameter space and its derivatives with respect to p parameters."""

    misfit: Float[np.ndarray, " n"]  # of all samples of a batch, shape (n,)
    used: Bool[np.ndarray, " n"]  # which of them count, shape (n,), bool
    size: int  # p
    # begins a pass over the derivatives of the samples that count: arrays of p columns whose rows follow one another
    blocks: Callable[[], Iterator[np.ndarray]]
    # R of [derivatives, misfit] = Q R, where it is known already; None elsewhere
    joint: Float[np.ndarray, "p1 p1"] | None = None
    gram: Float[np.ndarray, "p1 p1"] | None = None  # normal matrix of [derivatives, misfit], the same way

    @classmethod
    def of(
        cls, misfit: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n p"], used: Bool[np.ndarray, " n"]
    ) -> Linearization:
        """From the misfit of all samples and its derivatives; `used` says which samples count."""
        rows = chosen(jacobian, used)
        return cls(misfit, used, jacobian.shape[1], lambda: (rows[part] for part in parts(*rows.shape)))

    @functools.cached_property
    def root(self) -> Float[np.ndarray, "p1 p1"] | None:
        """A square root of the normal matrix of [derivatives, misfit], where either is known already."""
        return gram_root(self.gram) if self.gram is not None else self.joint

    def columns(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "m k"]:
        """Derivatives of the samples that count with respect to some parameters, in memory of their own."""
        out, row = np.empty((int(np.count_nonzero(self.used)), int(np.count_nonzero(which)))), 0
        for rows in self.blocks():
            out[row : row + len(rows)] = rows[:, which]
            row += len(rows)
        return out

    def factor(self, order: np.ndarray) -> Float[np.ndarray, "p1 p1"]:
        """R of [derivatives in an order of the parameters, misfit] = Q R."""
        if self.root is not None:
            return np.asarray(np.linalg.qr(self.root[:, [*order, self.size]], mode="r"))
        misfit, row = chosen(self.misfit, self.used), 0

        def rows() -> Iterator[np.ndarray]:
            nonlocal row
            for block in self.blocks():
                yield from beside(block, misfit[row : row + len(block)], order)
                row += len(block)

        return triangle(rows(), self.size + 1)

    def triangle(self, which: Bool[np.ndarray, " p"] | None = None) -> Float[np.ndarray, "k k"]:
        """R of the derivatives Q R with respect to some parameters, or all."""
        if self.root is not None:
            if (which is None or which.all()) and not np.tril(self.root, -1).any():
                return self.root[:-1, :-1]
            columns = self.root[:, :-1] if which is None else self.root[:, :-1][:, which]
            return np.asarray(np.linalg.qr(columns, mode="r"))
        if which is None or which.all():
            return triangle(self.blocks(), self.size)
        return triangle((rows[:, which] for rows in self.blocks()), int(np.count_nonzero(which)))

    def gradient(self) -> Float[np.ndarray, " p"]:
        """Derivatives of half the sum of squares."""
        if self.root is not None:
            return self.root[:, :-1].T @ self.root[:, -1]
        out, misfit, row = np.zeros(self.size), self.misfit[self.used], 0
        for rows in self.blocks():
            out += misfit[row : row + len(rows)] @ rows
            row += len(rows)
        return out
