"""Outputs of many models of one structure, a row each."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.fitting.solvers.lanes import BESIDE, device_for, placed, room
from hystfit.models.shared.simulation import run
from hystfit.params.coordinates import Coordinates

_NUMBERS = 2**24  # of outputs computed in one call


def chunks(count: int, samples: int) -> Iterator[tuple[np.ndarray, int]]:
    """Numbers of the rows of each call, of one length, the last one repeated where there are fewer; and how many there are."""
    size = min(room(count), max(1, _NUMBERS // samples))
    for begin in range(0, count, size):
        yield np.minimum(np.arange(begin, begin + size), count - 1), min(size, count - begin)


def simulated(
    coordinates: Coordinates,
    scales: Float[np.ndarray, "N p"],
    z: Float[np.ndarray, "N p"],
    u: np.ndarray,
    dt: np.ndarray,
) -> Float[np.ndarray, "N T"]:
    """Output of each loop's model, with what `shared_and_own` gives; u and dt of all have shape (T,), those of each (N, T)."""
    device = device_for(len(z))
    z, out, begin = np.asarray(z), np.empty((len(z), u.shape[-1])), 0
    for at, count in chunks(len(z), u.shape[-1]):
        inputs = (rows if rows.ndim == 1 else rows[at] for rows in (u, dt))
        rows = simulate_rows(*placed((coordinates, scales[at], z[at], *inputs), device), device.platform != "cpu")
        out[begin : begin + count] = np.asarray(rows)[:count]
        begin += count
    return out


def shared_and_own(coordinates: Coordinates) -> tuple[Coordinates, Float[np.ndarray, "N p"]]:
    """Coordinates of many rows as those of the first, and the scales of each: programs depend on no number of rows but that of a call."""
    scales = np.asarray(coordinates.scale)
    return eqx.tree_at(lambda c: c.scale, coordinates, scales[0]), scales


@functools.partial(jax.jit, static_argnames="together")
def simulate_rows(
    coordinates: Coordinates, scales: Array, z: Array, u: Array, dt: Array, together: bool
) -> Float[Array, "N T"]:
    """`simulated`, all rows side by side or some at a time."""
    every = {"scale": scales, "z": z, "u": u, "dt": dt}
    rows = {name: values for name, values in every.items() if values.ndim == 2}

    def one(row: dict[str, Array]) -> Array:
        scale, z, u, dt = (every | row).values()
        return run(eqx.tree_at(lambda c: c.scale, coordinates, scale).tree(z), u, dt)[0]

    if together:
        return jax.vmap(one)(rows)
    model = coordinates.treedef.unflatten(coordinates.leaves)
    # Rows side by side took 0.16 (Bouc-Wen) to 0.6 (Jiles-Atherton) of the time of one after another; where a model computes all
    # samples of a row at once, 1.3 to 1.7.
    beside = BESIDE if model.causal and model.one_scan else None
    return jax.lax.map(one, rows, batch_size=beside)
