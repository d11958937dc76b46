"""Levenberg-Marquardt for many lanes at once: pairs of a record and a start, of problems that differ in their numbers alone.

Lanes that go together take their steps side by side in one program, some steps a round, and those that have ended leave between two
rounds: all on a GPU, chunks that fit the cache on a CPU. Few lanes take their steps on the host, by a program that linearizes one after
another and takes less time to compile; so do those that are not done after one round there.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import device_of_many, first_device
from hystfit.fitting.levenberg_marquardt import Lane, advanced, approached, beaten
from hystfit.inference.normal import Normal, normal_at, normal_in_scan, suits_one_scan
from hystfit.inference.objective import Objective
from hystfit.params.coordinates import REAL
from hystfit.params.host_arrays import compiled

MANY = 1024  # lanes from which a GPU is worth its programs and copies
# Lanes that take their steps on the host at once: interrupts come through between steps, and arrays stay small.
_CHUNK = 64
_BESIDE = 256  # lanes that go together on a CPU, in the cache; a step took 0.6 of the time of one after another, at 1000 samples
_FEW = 64  # part of the lanes on a GPU that the CPU takes over: the next smaller program would take longer to compile
_PAYS = 4096  # lanes from which their program pays
_SAMPLES = 2**19  # of all lanes of such a call, at most
_TOGETHER = 2**30  # numbers of the data of the lanes that a GPU holds at once
_UNROLL = 8  # samples in one turn of the scan: 4096 lanes took 5 ms a pass on an H100, and 22 ms at one sample a turn
_ROUND = 6  # steps of lanes that go together, before those that have ended leave


class Stack(eqx.Module):
    """Objectives of one structure as one: arrays that differ have a leading axis of N records, the others have none.

    Attributes:
        objective: with these arrays.
        own: for each leaf of the objective, whether it has that axis.
    """

    objective: Objective
    own: tuple[bool, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, objectives: Sequence[Objective]) -> Stack:
        """Of separate objectives; every array of several gets the axis."""
        leaves, treedef = zip(*(jax.tree_util.tree_flatten(one) for one in objectives), strict=True)
        if len(objectives) == 1:
            return cls(objectives[0], (False,) * len(leaves[0]))
        columns = [np.stack([np.asarray(leaf) for leaf in column]) for column in zip(*leaves, strict=True)]
        return cls(treedef[0].unflatten(columns), (True,) * len(columns))

    def take(self, records: np.ndarray) -> Stack:
        """The stack of some records, in their order."""
        return Stack(self.at(records), self.own)

    def at(self, k: Any) -> Objective:
        """The objective of one record, or of several."""
        leaves, treedef = jax.tree_util.tree_flatten(self.objective)
        return treedef.unflatten([leaf[k] if own else leaf for leaf, own in zip(leaves, self.own, strict=True)])

    @property
    def samples(self) -> int:
        """Samples of a record, padding included."""
        batch = self.objective.batch
        return int(np.prod(batch.y.shape[-2:]))

    @property
    def bounded(self) -> np.ndarray:
        """Which parameters have bounds, shape (p,)."""
        return np.array(self.objective.coordinates.kinds) != REAL


class Ends(NamedTuple):
    """Where lanes ended, arrays of leading length L.

    Attributes:
        normal: normal equations there.
        converged: whether the predicted decrease of the cost fell below the tolerance.
        steps: linearizations.
        cost: half the sum of squared misfits, shape (L,). Of a lane that was given up: what its linear model promises, which is above the
            least cost of the lanes of its record that converged.
        beaten: which were given up, because they approached no lower cost than another lane of their record.
        damping: of the step that would be next, shape (L,).
    """

    normal: Normal
    converged: np.ndarray
    steps: np.ndarray
    cost: np.ndarray
    beaten: np.ndarray
    damping: np.ndarray


def descend_lanes(
    stack: Stack,
    records: np.ndarray,
    z: Float[np.ndarray, "L p"],
    *,
    gain: float,
    steps: int,
    damping: Float[np.ndarray, " L"] | None = None,
    device: Any = None,
) -> Ends:
    """Minimize half the sum of squared misfits from every lane.

    Args:
        stack: the problems.
        records: which of them each lane is of, shape (L,), those of one record side by side.
        z: starts, unconstrained.
        gain: decrease of the cost that the linear model promises, relative to the cost, below which a lane has converged.
        steps: linearizations of a lane at most.
        damping: of the first steps; that of other descents which the lanes continue.
        device: where; by default a GPU for many lanes where there is one, else the CPU.
    """
    device = device_for(len(z)) if device is None else device
    lane, numbers = Lane.at(np.array(z, float), damping), np.asarray(records)
    tolerance, left = np.float64(gain), np.arange(len(z))
    if device.platform != "cpu":
        for part in _parts(left, max(_TOGETHER // stack.samples, 1)):
            lane.put(part, _together(stack, numbers[part], lane.rows(part), tolerance, steps, device))
    elif len(z) >= _PAYS and suits_one_scan(stack.at(0)):
        for part in _parts(left, _BESIDE):
            going = lane.rows(part)
            lane.put(part, _together(stack, numbers[part], going, tolerance, min(_ROUND, steps), device, _BESIDE))
    left, given_up = left[~lane.ended & (lane.steps < steps)], np.zeros(len(z), bool)
    for part in _parts(left, _chunk(stack.samples)):
        ended, given_up[part] = _on_host(stack, numbers[part], lane.rows(part), tolerance, steps)
        lane.put(part, ended)
    cost = np.where(given_up, approached(lane, numbers), lane.best.cost)
    return Ends(lane.best, lane.converged, lane.steps, cost, given_up, lane.damping)


def device_for(lanes: int) -> Any:
    """A GPU for many lanes where JAX finds one, else the CPU."""
    return (device_of_many() if lanes >= MANY else None) or first_device("cpu")


def _chunk(samples: int) -> int:
    """Lanes that take their steps on the host at once."""
    return max(1, min(_CHUNK, _SAMPLES // samples))


def _parts(lanes: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Numbers of the lanes of each call."""
    for begin in range(0, len(lanes), size):
        yield lanes[begin : begin + size]


def _on_host(stack: Stack, records: np.ndarray, lane: Lane, gain: Any, steps: int) -> tuple[Lane, np.ndarray]:
    """Lanes at their ends, and which were given up; their program has room for any number of lanes of a chunk."""
    room_for, samples, bounded = _chunk(stack.samples), stack.samples, stack.bounded
    padded = lambda rows: np.concatenate([rows, np.zeros((room_for - len(rows), *rows.shape[1:]), rows.dtype)])
    data = placed(stack.take(padded(records)), first_device("cpu")) if any(stack.own) else stack
    given_up, count = np.zeros(len(records), bool), len(records)
    going = np.arange(count)
    while going.size:
        where, points = padded(going), padded(lane.trial[going])
        new = Normal(*_first(_linearized(data, where, points, np.int64(going.size)), going.size))
        with np.errstate(all="ignore"):  # of simulations that are not finite, whose steps are rejected
            lane.put(going, advanced(lane.rows(going), new, gain, samples, bounded, np))
        given_up |= beaten(lane, records)
        going = np.flatnonzero(~lane.ended & ~given_up & (lane.steps < steps))
    return lane, given_up


@compiled
def _linearized(stack: Stack, records: Array, z: Float[Array, "L p"], count: Array) -> tuple[Array, ...]:
    """Fields of the `Normal` at the first `count` points, one after another; zero at the others."""

    def one(k: Array, rows: Normal) -> Normal:
        new = normal_at(stack.at(records[k]), z[k])
        return jax.tree_util.tree_map(lambda all_rows, value: all_rows.at[k].set(value), rows, new)

    lanes, p = z.shape
    none = Normal(jnp.zeros((lanes, p)), jnp.zeros(lanes), jnp.zeros((lanes, p)), jnp.zeros((lanes, p, p)))
    return tuple(jax.lax.fori_loop(0, count, one, none))


def _together(
    stack: Stack, records: np.ndarray, lane: Lane, gain: Any, steps: int, device: Any, least: int = 1
) -> Lane:
    """Lanes at their ends, or after some steps, side by side on a device, where the data lie all the while.

    There is room for `least` lanes and records, so that any smaller number takes the same program. The last few lanes are left.
    """
    among, place = np.unique(records, return_inverse=True)
    rows = stack.take(among[np.minimum(np.arange(max(room(among.size), least)), among.size - 1)])
    data, going, most = placed(rows, device), np.arange(len(records)), max(room(len(records)), least)
    sizes = [-(-most // part) for part in (_FEW, 8, 1)]  # each is a program
    while going.size > most // _FEW:
        capacity = next(size for size in sizes if size >= going.size)
        at = going[np.minimum(np.arange(capacity), going.size - 1)]
        arguments = placed((place[at], lane.rows(at)), device)
        unroll = 1 if device.platform == "cpu" else _UNROLL
        new = _advance_all(data, *arguments, gain, min(_ROUND, steps), unroll)
        new = _first(new, going.size)
        lane.put(going, new)
        going = going[~new.ended & (new.steps < steps)]
    return lane


def _first(rows: Any, count: int) -> Any:
    """The first rows of arrays, as arrays of NumPy."""
    return jax.tree_util.tree_map(lambda values: np.asarray(values)[:count], rows)


def room(count: int) -> int:
    """The next power of two: arrays of few lengths need few programs."""
    return 1 << max(count - 1, 0).bit_length()


def placed(tree: Any, device: Any) -> Any:
    """Arrays on a device."""
    return jax.device_put(tree, device)


@functools.partial(jax.jit, static_argnums=(4, 5))
def _advance_all(stack: Stack, records: Array, lane: Lane, gain: Array, most: int, unroll: int) -> Lane:
    """All lanes after at most `most` steps, side by side."""
    in_scan = functools.partial(normal_in_scan, unroll=unroll)
    normal = in_scan if suits_one_scan(stack.at(0)) else normal_at
    samples, bounded = stack.samples, stack.bounded

    def some_steps(own: Stack, lane: Lane) -> Lane:
        end = lane.steps + most
        once = lambda lane: advanced(lane, normal(own.objective, lane.trial), gain, samples, bounded, jnp)
        return jax.lax.while_loop(lambda lane: ~lane.ended & (lane.steps < end), once, lane)

    axes = jax.tree_util.tree_structure(stack).unflatten([0 if own else None for own in stack.own])
    return jax.vmap(some_steps, in_axes=(axes, 0))(stack.take(records), lane)
