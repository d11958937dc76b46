"""Levenberg-Marquardt for many lanes at once: pairs of a record and a start, of problems that differ in their numbers alone.

Lanes that go together take their steps side by side, some steps a round, and those that have ended leave between two rounds: all on a
GPU, chunks that fit the cache on a CPU. Few lanes descend one after another on a CPU, by a program that takes a quarter of the time to
compile; so do those that are not done after one round there.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import device_of_many, first_device
from hystfit.fitting.polish import LEAST_DAMPING, LONGEST_STEP, MOST_DAMPING, ROUNDING
from hystfit.inference.normal import Normal, normal_at, normal_in_scan, suits_one_scan
from hystfit.inference.objective import Objective

MANY = 1024  # lanes from which a GPU is worth its programs and copies
# Lanes that one call descends one after another: interrupts come through between calls, and arrays stay small.
_CHUNK = 64
_BESIDE = 256  # lanes that go together on a CPU, in the cache; a step took 0.6 of the time of one after another, at 1000 samples
_FEW = 64  # part of the lanes on a GPU that the CPU takes over: the next smaller program would take longer to compile
_PAYS = 4096  # lanes from which their program pays
_SAMPLES = 2**19  # of all lanes of such a call, at most
_TOGETHER = 2**30  # numbers of the data of the lanes that a GPU holds at once
_UNROLL = 8  # samples in one turn of the scan: 4096 lanes took 5 ms a pass on an H100, and 22 ms at one sample a turn
_ROUND = 6  # steps of lanes that go together, before those that have ended leave
_EQUAL = 1e-12  # relative difference of two costs that rounding may cause, below which the linear model decides
# At a crease of the cost, as the limits of a branch make them, no step is shorter than what the linear model promises. A hundredth of a
# standard error may be left, which is this part of the cost times the number of samples.
_CREASE, _SHORT_STEP = 1e-4, 1.0  # and the damping from which a step is short
_FIRST = 1e-3  # damping


class Stack(NamedTuple):
    """Objectives of one structure as one: arrays that differ have a leading axis of N records, the others have none.

    Attributes:
        objective: with these arrays.
        own: for each leaf of the objective, whether it has that axis.
    """

    objective: Objective
    own: tuple[bool, ...]

    @classmethod
    def of(cls, objectives: Sequence[Objective]) -> Stack:
        """Of separate objectives; every array gets the axis."""
        leaves, treedef = zip(*(jax.tree_util.tree_flatten(one) for one in objectives), strict=True)
        columns = [np.stack([np.asarray(leaf) for leaf in column]) for column in zip(*leaves, strict=True)]
        return cls(treedef[0].unflatten(columns), (True,) * len(columns))

    def take(self, records: np.ndarray) -> Stack:
        """The stack of some records, in their order."""
        leaves, treedef = jax.tree_util.tree_flatten(self.objective)
        return Stack(
            treedef.unflatten([leaf[records] if own else leaf for leaf, own in zip(leaves, self.own, strict=True)]),
            self.own,
        )

    @property
    def samples(self) -> int:
        """Samples of a record, padding included."""
        batch = self.objective.batch
        return int(np.prod(batch.y.shape[-2:]))


class Ends(NamedTuple):
    """Where lanes ended, arrays of leading length L.

    Attributes:
        normal: normal equations there.
        converged: whether the predicted decrease of the cost fell below the tolerance.
        steps: linearizations.
    """

    normal: Normal
    converged: np.ndarray
    steps: np.ndarray


class _Lane(NamedTuple):
    """The state of a descent: its best point, the next to try, damping, whether the next is the last, whether it ended, steps."""

    best: Normal
    trial: Array
    damping: Array
    last: Array
    ended: Array
    steps: Array

    @classmethod
    def at(cls, z: Float[np.ndarray, "L p"]) -> _Lane:
        """Lanes before their first step."""
        count, p = z.shape
        none, no = np.zeros(count), np.zeros(count, bool)
        best = Normal(z.copy(), none + np.inf, np.zeros((count, p)), np.zeros((count, p, p)))
        return cls(best, z, none + _FIRST, no, no.copy(), none.astype(int))

    def rows(self, at: Any) -> _Lane:
        """Some of the lanes."""
        return jax.tree_util.tree_map(lambda v: v[at], self)

    def put(self, at: np.ndarray, lanes: _Lane) -> None:
        """Replace some of the lanes."""
        for mine, new in zip(jax.tree_util.tree_leaves(self), jax.tree_util.tree_leaves(lanes), strict=True):
            mine[at] = new


def descend_lanes(
    stack: Stack, records: np.ndarray, z: Float[np.ndarray, "L p"], *, gain: float, steps: int, device: Any = None
) -> Ends:
    """Minimize half the sum of squared misfits from every lane.

    Args:
        stack: the problems.
        records: which of them each lane is of, shape (L,).
        z: starts, unconstrained.
        gain: decrease of the cost that the linear model promises, relative to the cost, below which a lane has converged.
        steps: linearizations of a lane at most.
        device: where; by default a GPU for many lanes where there is one, else the CPU.
    """
    device = device_for(len(z)) if device is None else device
    lane, numbers = _Lane.at(np.array(z, float)), np.asarray(records)
    tolerance, left = np.float64(gain), np.arange(len(z))
    if device.platform != "cpu":
        for part in _parts(left, max(_TOGETHER // stack.samples, 1)):
            lane.put(part, _together(stack, numbers[part], lane.rows(part), tolerance, steps, device))
    elif len(z) >= _PAYS and suits_one_scan(objective_at(stack.objective, stack.own, 0)):
        for part in _parts(left, _BESIDE):
            going = lane.rows(part)
            lane.put(part, _together(stack, numbers[part], going, tolerance, min(_ROUND, steps), device, _BESIDE))
    left = left[~lane.ended & (lane.steps < steps)]
    size = _chunk(stack.samples)
    for part in _parts(left, size):
        lane.put(part, _one_by_one(stack, numbers[part], lane.rows(part), size, gain=tolerance, steps=steps))
    good = lane.last & lane.ended & np.isfinite(lane.best.cost)
    return Ends(lane.best, good, lane.steps)


def device_for(lanes: int) -> Any:
    """A GPU for many lanes where JAX finds one, else the CPU."""
    return (device_of_many() if lanes >= MANY else None) or first_device("cpu")


def _chunk(samples: int) -> int:
    """Lanes of one call on a CPU."""
    return max(1, min(_CHUNK, _SAMPLES // samples))


def _parts(lanes: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Numbers of the lanes of each call."""
    for begin in range(0, len(lanes), size):
        yield lanes[begin : begin + size]


def _one_by_one(
    stack: Stack, records: np.ndarray, lane: _Lane, capacity: int, *, gain: Any, steps: int
) -> _Lane:
    """Lanes at their ends, on the CPU; there is room for `capacity`, so that any number of lanes takes one program."""
    count = len(records)
    pad = np.minimum(np.arange(capacity), count - 1)
    arguments = placed((stack.take(records[pad]).objective, lane.rows(pad)), first_device("cpu"))
    return _on_host(_descend_each(*arguments, np.int64(count), gain, steps, stack.own), count)


def _together(
    stack: Stack, records: np.ndarray, lane: _Lane, gain: Any, steps: int, device: Any, least: int = 1
) -> _Lane:
    """Lanes at their ends, or after some steps, side by side on a device, where the data lie all the while.

    There is room for `least` lanes and records, so that any smaller number takes the same program. The last few lanes are left.
    """
    among, place = np.unique(records, return_inverse=True)
    rows = stack.take(among[np.minimum(np.arange(max(room(among.size), least)), among.size - 1)])
    objective, going, most = placed(rows.objective, device), np.arange(len(records)), max(room(len(records)), least)
    sizes = [-(-most // part) for part in (_FEW, 8, 1)]  # each is a program
    while going.size > most // _FEW:
        capacity = next(size for size in sizes if size >= going.size)
        at = going[np.minimum(np.arange(capacity), going.size - 1)]
        arguments = placed((place[at], lane.rows(at)), device)
        advanced = _advance_all(objective, *arguments, gain, min(_ROUND, steps), stack.own, _unroll(device))
        new = _on_host(advanced, going.size)
        lane.put(going, new)
        going = going[~new.ended & (new.steps < steps)]
    return lane


def _unroll(device: Any) -> int:
    return 1 if device.platform == "cpu" else _UNROLL


def room(count: int) -> int:
    """The next power of two: arrays of few lengths need few programs."""
    return 1 << max(count - 1, 0).bit_length()


def placed(tree: Any, device: Any) -> Any:
    """Arrays on a device."""
    return jax.device_put(tree, device)


def _on_host(lane: _Lane, count: int) -> _Lane:
    """The first `count` lanes as arrays of NumPy."""
    return jax.tree_util.tree_map(lambda v: np.asarray(v)[:count], lane)


@functools.partial(jax.jit, static_argnums=(4, 5))
def _descend_each(
    objective: Objective, lane: _Lane, count: Array, gain: Array, steps: int, own: tuple[bool, ...]
) -> _Lane:
    """The first `count` lanes at their ends, one after another; lane k is of record k."""

    def one(k: Array, lanes: _Lane) -> _Lane:
        new = _descend(normal_at, objective_at(objective, own, k), lanes.rows(k), gain, steps)
        return jax.tree_util.tree_map(lambda rows, value: rows.at[k].set(value), lanes, new)

    return jax.lax.fori_loop(0, count, one, lane)


@functools.partial(jax.jit, static_argnums=(4, 5, 6))
def _advance_all(
    objective: Objective, records: Array, lane: _Lane, gain: Array, most: int, own: tuple[bool, ...], unroll: int
) -> _Lane:
    """All lanes after at most `most` steps, side by side."""
    in_scan = functools.partial(normal_in_scan, unroll=unroll)
    normal = in_scan if suits_one_scan(objective_at(objective, own, 0)) else normal_at
    rows = objective_at(objective, own, records)
    axes = jax.tree_util.tree_structure(objective).unflatten([0 if one else None for one in own])
    advanced = lambda objective, lane: _descend(normal, objective, lane, gain, most)
    return jax.vmap(advanced, in_axes=(axes, 0))(rows, lane)


def objective_at(objective: Objective, own: tuple[bool, ...], k: Any) -> Objective:
    """The objective of one record, or of several."""
    leaves, treedef = jax.tree_util.tree_flatten(objective)
    return treedef.unflatten([leaf[k] if one else leaf for leaf, one in zip(leaves, own, strict=True)])


def _descend(normal: Callable[..., Normal], objective: Objective, lane: _Lane, gain: Any, most: int) -> _Lane:
    """One lane after at most `most` steps."""
    samples, end = objective.batch.u.size, lane.steps + most

    def once(lane: _Lane) -> _Lane:
        new = normal(objective, lane.trial)
        # The last step may change the cost by less than rounding does.
        better = new.cost < jnp.where(lane.last, lane.best.cost * (1 + _EQUAL), lane.best.cost)
        softer = jnp.where(jnp.isinf(lane.best.cost), lane.damping, jnp.maximum(0.1 * lane.damping, LEAST_DAMPING))
        damping = jnp.where(better, softer, 10.0 * lane.damping)
        best = jax.tree_util.tree_map(lambda a, b: jnp.where(better, a, b), new, lane.best)
        # Damping holds the directions that the data hardly determine: what is left to gain shows without it.
        (step, _), (whole, predicted) = _step(best, damping), _step(best, LEAST_DAMPING)
        floor = ROUNDING**2 * samples
        near = predicted <= jnp.maximum(gain, _EQUAL) * best.cost + floor
        settled = ~better | (predicted <= gain * best.cost + floor)
        crease = ~better & (damping >= _SHORT_STEP) & (predicted <= _CREASE / samples * best.cost)
        ended = (lane.last & settled) | crease | (damping >= MOST_DAMPING) | jnp.isinf(best.cost)
        return _Lane(
            best, best.z + jnp.where(near, whole, step), damping, lane.last | near | crease, ended, lane.steps + 1
        )

    return jax.lax.while_loop(lambda lane: ~lane.ended & (lane.steps < end), once, lane)


def _step(point: Normal, damping: Array | float) -> tuple[Array, Array]:
    """The damped step, and the decrease of the cost that the linear model predicts for it."""
    diagonal = jnp.diag(point.matrix)
    scale = 1 / jnp.sqrt(jnp.maximum(diagonal, 1e-24 * jnp.max(diagonal) + 1e-300))
    scaled = point.matrix * scale[:, None] * scale[None, :]
    step = -scale * jnp.linalg.solve(scaled + damping * jnp.eye(scale.size), scale * point.gradient)
    step = step * jnp.minimum(1.0, LONGEST_STEP / jnp.maximum(jnp.max(jnp.abs(step)), 1e-300))
    return step, -(point.gradient @ step + 0.5 * step @ point.matrix @ step)
