"""A misfit and its derivatives, block after block of samples: hundreds of weights would fill the memory with the derivatives of all."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Bool, Float

from hystfit.inference.blocks import chosen, parts, triangle


@dataclasses.dataclass(frozen=True)
class Linearization:
    """A misfit at one point of parameter space and its derivatives with respect to p parameters.

    Attributes:
        misfit: of all samples of a batch, shape (n,).
        used: which of them count, shape (n,), bool.
        size: p.
        blocks: begins a pass over the derivatives of the samples that count: arrays of p columns whose rows follow one another.
    """

    misfit: Float[np.ndarray, " n"]
    used: Bool[np.ndarray, " n"]
    size: int
    blocks: Callable[[], Iterator[np.ndarray]]

    @classmethod
    def of(
        cls, misfit: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n p"], used: Bool[np.ndarray, " n"]
    ) -> Linearization:
        """From the misfit of all samples and its derivatives; `used` says which samples count."""
        rows = chosen(jacobian, used)
        return cls(misfit, used, jacobian.shape[1], lambda: (rows[part] for part in parts(*rows.shape)))

    def columns(self, which: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "m k"]:
        """Derivatives of the samples that count with respect to some parameters, in memory of their own."""
        out, row = np.empty((int(np.count_nonzero(self.used)), int(np.count_nonzero(which)))), 0
        for rows in self.blocks():
            out[row : row + len(rows)] = rows[:, which]
            row += len(rows)
        return out

    def triangle(self, which: Bool[np.ndarray, " p"] | None = None) -> Float[np.ndarray, "k k"]:
        """R of the derivatives Q R with respect to some parameters, or all."""
        if which is None or which.all():
            return triangle(self.blocks(), self.size)
        return triangle((rows[:, which] for rows in self.blocks()), int(np.count_nonzero(which)))

    def gradient(self) -> Float[np.ndarray, " p"]:
        """Derivatives of half the sum of squares."""
        out, misfit, row = np.zeros(self.size), self.misfit[self.used], 0
        for rows in self.blocks():
            out += misfit[row : row + len(rows)] @ rows
            row += len(rows)
        return out
