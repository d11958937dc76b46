"""Everett functions: the mass E(a, b) of the relays whose thresholds lie in the triangle a >= alpha >= beta >= b; outputs from them.

Masses are given cell by cell between n + 1 levels, uniform within a cell; cell (i, j), j <= i, is alpha in (L_i, L_{i+1}), beta in
(L_j, L_{j+1}), a triangle where j = i. E is then bilinear but for the diagonal cells, which add squares. Rows run over i, j
with j the faster (`numpy.tril_indices`).
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used
from jaxtyping import Array, Bool, Float, Int

from hystfit.models.shared.shapes import Scalar

AnyArray = Array | np.ndarray  # for functions that serve host and device

# Of symmetric densities, relative to rows and columns: chosen among 1 to 100 by the loops of three measured materials (mag_ja_bh), each
# predicted from the others of its material.
_ALONG_COERCIVITY = 4.0


@functools.lru_cache(maxsize=16)
def cells(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row i and column j of every cell, shapes (n (n + 1) / 2,)."""
    return np.tril_indices(n)


@functools.lru_cache(maxsize=16)
def mirror(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells tied by symmetry: (the independent weight of each cell, the cell and its mirror image of each weight, (2, p))."""
    image = _images(n)
    first, inverse = np.unique(np.minimum(np.arange(image.size), image), return_inverse=True)
    return inverse, np.stack([first, image[first]])


def _images(n: int) -> np.ndarray:
    """Number of the mirror image of every cell in the line alpha + beta = 0: of cell (i, j) it is (n - 1 - j, n - 1 - i)."""
    i, j = cells(n)
    return (n - 1 - j) * (n - j) // 2 + (n - 1 - i)


def fold(columns: np.ndarray, n: int) -> np.ndarray:
    """Columns for all cells added up to columns for the independent weights of a symmetric model."""
    first, image = mirror(n)[1]
    return columns[..., first] + np.where(first == image, 0.0, columns[..., image])


def second_differences(n: int, symmetric: bool) -> scipy.sparse.csr_array:
    """Matrix of the second differences of n (n + 1) / 2 weights along rows and columns, on the independent weights.

    A symmetric model has more of them, along lines of one interaction field (alpha + beta): loops about one center leave the density
    between two amplitudes open, which then continues that of smaller coercivities at the same interaction field.
    """
    i, j = cells(n)
    at = -np.ones((n + 2, n + 2), dtype=int)
    at[i + 1, j + 1] = np.arange(i.size)
    density = np.where(symmetric & (i == j), 2.0, 1.0)  # a cell on the diagonal has half the area of the others
    blocks = []
    for di, dj, stiffness in ((1, 0, 1.0), (0, 1, 1.0), (1, -1, _ALONG_COERCIVITY if symmetric else 0.0)):
        parts = np.stack([at[i + 1 + k * di, j + 1 + k * dj] for k in (-1, 0, 1)], axis=1)
        inside = parts[(parts >= 0).all(axis=1) & (stiffness > 0)]
        values = np.array([1.0, -2.0, 1.0]) * np.sqrt(stiffness) * density[inside]
        ends = 3 * np.arange(len(inside) + 1)
        blocks.append(scipy.sparse.csr_array((values.ravel(), inside.ravel(), ends), shape=(len(inside), i.size)))
    rough = scipy.sparse.vstack(blocks, format="csr")
    if not symmetric:
        return rough  # type: ignore[return-value]
    weight = mirror(n)[0]
    return rough @ scipy.sparse.csr_array((np.ones(i.size), weight, np.arange(i.size + 1)))


def grid(w: Float[Array, " cells"], n: int) -> Float[Array, "n n"]:
    """Weights as a square, zero above the diagonal."""
    i, j = cells(n)
    return jnp.zeros((n, n), w.dtype).at[i, j].set(w)


def accumulate(square: Float[Array, "n n"]) -> Float[Array, "m m"]:
    """Table of sums over rows below a and columns from b on, a, b = 0..n: shape (n + 1, n + 1)."""
    n = square.shape[0]
    # Two triangular products: faster than two cumulative sums for the sizes of interest, and so is their transpose.
    below, beyond = np.tri(n + 1, n, -1), np.tri(n, n + 1)
    return jnp.asarray(below, square.dtype) @ square @ jnp.asarray(beyond, square.dtype)


class Place(eqx.Module):
    """Inputs as cell number and fraction of the cell below them; fractions of inputs outside the levels are 0 or 1."""

    cell: Int[Array, "..."]
    part: Float[Array, "..."]


def place(levels: Float[Array, " m"], u: Float[Array, "..."]) -> Place:
    """Locate inputs among levels (at least two)."""
    cell = jnp.clip(jnp.searchsorted(levels, u, side="right") - 1, 0, levels.shape[0] - 2)
    part = (u - levels[cell]) / (levels[cell + 1] - levels[cell])
    return Place(cell, jnp.clip(part, 0.0, 1.0))


class Everett(eqx.Module):
    """The function E of cell masses, ready for look-up: sums of the cells off the diagonal, masses and their sums of those on it."""

    off: Float[Array, "m m"]
    diagonal: Float[Array, " n"]
    sums: Float[Array, " m"]

    @classmethod
    def of(cls, w: Float[Array, " cells"], n: int) -> Everett:
        """Tables of weights, shape (n (n + 1) / 2,)."""
        square = grid(w, n)
        diagonal = jnp.diagonal(square)
        sums = jnp.concatenate([jnp.zeros(1, w.dtype), jnp.cumsum(diagonal)])
        return cls(accumulate(square - jnp.diag(diagonal)), diagonal, sums)

    def __call__(self, high: Place, low: Place) -> Float[Array, "..."]:
        """E at inputs high >= low."""
        i, p, j, q = high.cell, high.part, low.cell, low.part
        flat, width = self.off.reshape(-1), self.off.shape[1]
        at = i * width + j
        near = (1 - q) * flat[at] + q * flat[at + 1]
        far = (1 - q) * flat[at + width] + q * flat[at + width + 1]
        across = self.sums[i] - self.sums[j + 1] + p**2 * self.diagonal[i] + (1 - q) ** 2 * self.diagonal[j]
        inside = (p - q) ** 2 * self.diagonal[i]
        return (1 - p) * near + p * far + jnp.where(i == j, inside, across)

    @property
    def total(self) -> Scalar:
        """Mass of all relays."""
        return self.off[-1, 0] + self.sums[-1]


def first_rise_masses(levels: AnyArray, center: AnyArray, row: AnyArray, x: AnyArray, xp: Any = jnp) -> AnyArray:
    """Parts of the cells of a row, (..., n), in alpha <= x and alpha + beta >= 2 center: what a first rise to x switches.

    `row` and `x` have one shape (...); a rise counts within its row only. Columns above the diagonal are 0.
    """
    base = levels[row]
    x = xp.clip(x, base, levels[row + 1])
    width = levels[row + 1] - base
    d = levels[1:] - levels[:-1]
    shift = 2 * center - levels[1:]
    square = lambda z: xp.maximum(z, 0.0) ** 2
    ramp = lambda z: 0.5 * (square(z) - square(z - d))
    cell = (ramp(x[..., None] - shift) - ramp(base[..., None] - shift)) / (width[..., None] * d)
    bent = square(x - center) - 0.5 * square(x - 2 * center + base)
    triangle = xp.where(center > base, bent, 0.5 * (x - base) ** 2) / (0.5 * width**2)
    column = xp.arange(levels.shape[0] - 1)
    row = row[..., None]
    return xp.where(column < row, cell, xp.where(column == row, triangle[..., None], 0.0))


class FirstRise(eqx.Module):
    """Mass that a first rise from the demagnetized state, at rest in `center`, switches up; `sums`: by a rise to each level."""

    square: Float[Array, "n n"]
    sums: Float[Array, " m"]
    levels: Float[Array, " m"]
    center: Scalar

    @classmethod
    def of(cls, w: Float[Array, " cells"], levels: Float[Array, " m"], center: Scalar) -> FirstRise:
        """Tables of weights."""
        n = levels.shape[0] - 1
        square = grid(w, n)
        rows = jnp.sum(square * first_rise_masses(levels, center, jnp.arange(n), levels[1:]), axis=1)
        return cls(square, jnp.concatenate([jnp.zeros(1, w.dtype), jnp.cumsum(rows)]), levels, center)

    @classmethod
    def falling(cls, w: Float[Array, " cells"], levels: Float[Array, " m"], center: Scalar) -> FirstRise:
        """The same for first falls: a fall to u switches what a rise to 2 center - u does in the mirror image."""
        return cls.of(w[_images(levels.shape[0] - 1)], 2 * center - levels[::-1], center)

    def __call__(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """Mass that a rise to u switches."""
        row = place(self.levels, u).cell
        return self.sums[row] + jnp.sum(self.square[row] * first_rise_masses(self.levels, self.center, row, u), axis=-1)


class CellMemory(eqx.Module):
    """Tables of a model with cells; output = rest + first(e_0) + sum over k of pair(e_{k+1}, e_k).

    `up`, `down` are the mass switched by a first excursion from an asymmetric demagnetized state, None where it is not needed; `rest` is
    the output of the initial state.
    """

    everett: Everett
    up: FirstRise | None
    down: FirstRise | None
    rest: Scalar
    levels: Float[Array, " m"]
    center: Scalar
    initial: str = eqx.field(static=True)

    @classmethod
    def of(
        cls, w: Float[Array, " cells"], levels: Float[Array, " m"], center: Scalar, initial: str, symmetric: bool
    ) -> CellMemory:
        """Tables of the masses of cells."""
        everett = Everett.of(w, levels.shape[0] - 1)
        up = down = None
        if initial == "demagnetized" and not symmetric:
            up, down = FirstRise.of(w, levels, center), FirstRise.falling(w, levels, center)
            rest = everett.total - 2 * up.sums[-1]
        else:
            rest = {"demagnetized": 0.0, "negative": -1.0, "positive": 1.0}[initial] * everett.total
        return cls(everett, up, down, rest, levels, center, initial)

    def place(self, u: Float[Array, "..."]) -> Place:
        """Locate inputs."""
        return place(self.levels, u)

    def first(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """What the first excursion, to u, adds to the output."""
        if self.initial == "negative":
            return 2 * self.everett(self.place(u), self.place(self.levels[0]))
        if self.initial == "positive":
            return -2 * self.everett(self.place(self.levels[-1]), self.place(u))
        if self.up is not None and self.down is not None:
            return jnp.where(u >= self.center, 2 * self.up(u), -2 * self.down(2 * self.center - u))
        image = 2 * self.center - u
        mass = self.everett(self.place(jnp.maximum(u, image)), self.place(jnp.minimum(u, image)))
        return jnp.where(u >= self.center, mass, -mass)

    def pair(self, now: Place, before: Place, rising: Bool[Array, "..."]) -> Float[Array, "..."]:
        """What a move from one extremum to the next adds to the output."""
        pick = lambda a, b: Place(jnp.where(rising, a.cell, b.cell), jnp.where(rising, a.part, b.part))
        return jnp.where(rising, 2.0, -2.0) * self.everett(pick(now, before), pick(before, now))
