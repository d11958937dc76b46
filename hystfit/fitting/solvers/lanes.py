"""Levenberg-Marquardt for many lanes at once. A lane is one start of one problem; the problems differ only in the values of their arrays.

On a GPU, one program advances all lanes by a few steps per round, and lanes that have ended are removed between rounds. On a CPU, the host
takes the steps and a compiled program linearizes the lanes: several at a time, to fill the vector registers, if there are many lanes, and
otherwise one after another, which compiles faster.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import device_of_many, few_runs, first_device
from hystfit.fitting.solvers.levenberg_marquardt import Lane, advanced, approached, beaten
from hystfit.inference.normal import (
    Normal,
    normal_at,
    normal_in_scan,
    normal_on_host,
    suits_lanes,
    suits_one_scan,
)
from hystfit.inference.objective import Objective
from hystfit.params.host_arrays import compiled

MANY = 1024  # lanes from which a GPU saves more time than its programs and copies cost
# Lanes per call on the host, for few and for many lanes: this keeps arrays small and allows interrupts between steps.
_CHUNK = 64, 256
BESIDE = (
    16  # lanes linearized together on a CPU, in 0.5 (Bouc-Wen), 0.4 (Duhem) or 0.9 (LuGre) of the time of single lanes
)
_PAYS = 2**18  # total samples of all lanes from which linearizing several together repays its compilation
_FEW = 64  # the CPU takes over the last 1/64 of the lanes of a GPU: a smaller GPU program would take longer to compile
_SAMPLES = 2**19  # most samples of all lanes of a call on the host
_UNROLL = 8  # samples per iteration of the scan: 4096 lanes took 5 ms per pass on an H100, and 22 ms with one sample per iteration
_ROUND = 6  # steps per round on a GPU


class Stack(eqx.Module):
    """Objectives of N records as one pytree: its `own` leaves differ between records and have an axis of N, the others are shared."""

    objective: Objective
    own: tuple[bool, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, objectives: Sequence[Objective]) -> Stack:
        """Stack separate objectives. With more than one, every array gets the leading axis."""
        leaves, treedef = zip(*(jax.tree_util.tree_flatten(one) for one in objectives), strict=True)
        if len(objectives) == 1:
            return cls(objectives[0], (False,) * len(leaves[0]))
        columns = [np.stack([np.asarray(leaf) for leaf in column]) for column in zip(*leaves, strict=True)]
        return cls(treedef[0].unflatten(columns), (True,) * len(columns))

    def take(self, records: np.ndarray | slice) -> Stack:
        """The stack of some records, in their order."""
        return Stack(self.at(records), self.own)

    def at(self, k: Any) -> Objective:
        """The objective of one record, or of several."""
        leaves, treedef = jax.tree_util.tree_flatten(self.objective)
        return treedef.unflatten([leaf[k] if own else leaf for leaf, own in zip(leaves, self.own, strict=True)])

    def side_by_side(self, function: Callable[[Objective, Any], Any]) -> Callable[[Stack, Any], Any]:
        """Vectorize `function(objective, rows)` over the records of a stack like this one, and over the leading axis of rows."""
        axes = jax.tree_util.tree_structure(self).unflatten([0 if own else None for own in self.own])
        return jax.vmap(lambda one, rows: function(one.objective, rows), in_axes=(axes, 0))

    @property
    def samples(self) -> int:
        """Samples of a record, padding included."""
        batch = self.objective.batch
        return int(np.prod(batch.y.shape[-2:]))

    @property
    def count(self) -> int:
        """Number of records; 1 if all arrays are shared."""
        leaves = jax.tree_util.tree_leaves(self.objective)
        return next((len(leaf) for leaf, own in zip(leaves, self.own, strict=True) if own), 1)

    @property
    def kinds(self) -> tuple[int, ...]:
        """Of the bounds of the parameters."""
        return self.objective.coordinates.kinds


class Ends(NamedTuple):
    """Where lanes ended, arrays of leading length L."""

    normal: Normal  # normal equations there
    converged: np.ndarray  # whether the predicted decrease of the cost fell below the tolerance
    steps: np.ndarray  # number of linearizations
    # half the sum of squared misfits, shape (L,); for a lane that was given up, the prediction of its linear model, which is above the cost
    # of the best converged lane of its record
    cost: np.ndarray
    # which lanes were given up because another lane of their record has a lower cost than they can reach
    beaten: np.ndarray
    damping: np.ndarray  # damping of the next step, shape (L,)
    promised: np.ndarray  # decrease of the cost to the minimum, as predicted by the linear model, shape (L,)


def descend_lanes(
    stack: Stack,
    records: np.ndarray,
    z: Float[np.ndarray, "L p"],
    *,
    gain: float,
    steps: int,
    damping: Float[np.ndarray, " L"] | None = None,
    device: Any = None,
    beside: int = 0,
) -> Ends:
    """Minimize half the sum of squared misfits from every lane.

    Lanes start at unconstrained z; `records` are the numbers of their records, shape (L,), and lanes of one record are adjacent. A lane has
    converged below `gain`, a relative decrease of the cost predicted by the linear model, and takes so many steps at most. The damping of
    the first steps continues earlier descents. The device is by default a GPU for many lanes if there is one, else the CPU; `beside` is the
    number of lanes of an earlier call, whose program can be reused.
    """
    device = device_for(len(z)) if device is None else device
    lane, numbers = Lane.at(np.array(z, float), damping), np.asarray(records)
    tolerance, left = np.float64(gain), np.arange(len(z))
    if device.platform != "cpu":
        for part in _parts(left, max(2**30 // stack.samples, 1)):  # whose data a GPU holds at once
            lane.put(part, _together(stack, numbers[part], lane.rows(part), tolerance, steps, device))
    left, given_up = left[~lane.ended & (lane.steps < steps)], np.zeros(len(z), bool)
    many = max(left.size, beside) * stack.samples >= _PAYS
    for part in _parts(left, _chunk(stack.samples, many)):
        ended, given_up[part] = _on_host(stack, numbers[part], lane.rows(part), tolerance, steps, many)
        lane.put(part, ended)
    cost = np.where(given_up, approached(lane, numbers), lane.best.cost)
    return Ends(lane.best, lane.converged, lane.steps, cost, given_up, lane.damping, lane.promised)


def go_on(ends: Ends, lanes: np.ndarray, run: Callable[[np.ndarray, np.ndarray], Ends]) -> None:
    """Continue, in place, descents of lanes that have neither converged nor been given up; `run` descends lanes from their points z."""
    lanes = lanes[~ends.converged[lanes] & ~ends.beaten[lanes] & np.isfinite(ends.cost[lanes])]
    if lanes.size:
        more = run(lanes, ends.normal.z[lanes])
        ends.steps[lanes] += more.steps
        better = more.cost <= ends.cost[lanes]
        more = more._replace(steps=ends.steps[lanes])
        for mine, new in zip(jax.tree_util.tree_leaves(ends), jax.tree_util.tree_leaves(more), strict=True):
            mine[lanes[better]] = new[better]


def device_for(lanes: int) -> Any:
    """A GPU for many lanes where JAX finds one, else the CPU."""
    return (device_of_many() if lanes >= MANY else None) or first_device("cpu")


def _chunk(samples: int, many: bool) -> int:
    """Lanes per call on the host; for many lanes a multiple of `BESIDE`."""
    most = max(1, min(_CHUNK[many], _SAMPLES // samples))
    return most - most % BESIDE if many and most > BESIDE else most


def _parts(lanes: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Split lanes into groups of at most `size`, one per call."""
    for begin in range(0, len(lanes), size):
        yield lanes[begin : begin + size]


def _on_host(
    stack: Stack, records: np.ndarray, lane: Lane, gain: Any, steps: int, many: bool
) -> tuple[Lane, np.ndarray]:
    """Lanes at their ends, and which were given up. Arrays are padded to a chunk, so that one program serves any number of lanes."""
    room_for, samples, kinds = _chunk(stack.samples, many), stack.samples, stack.kinds
    linearized = _linearized_beside if many else _linearized
    alone = few_runs() and not many and not any(stack.own)  # by the program that other uses need too
    padded = lambda rows: np.concatenate([rows, np.zeros((room_for - len(rows), *rows.shape[1:]), rows.dtype)])
    if any(stack.own):
        data, place = _of_records(stack, records, room_for)
    else:
        data, place = stack if many else Stack.of([stack.objective.with_room()]), records
    given_up, count = np.zeros(len(records), bool), len(records)
    going = np.arange(count)
    while going.size:
        if alone:
            each = [normal_on_host(stack.objective, z) for z in lane.trial[going]]
            new = Normal(*map(np.stack, zip(*each, strict=True)))
        else:
            where, points = padded(place[going]), padded(lane.trial[going])
            new = Normal(*_first(linearized(data, where, points, np.int64(going.size)), going.size))
        with np.errstate(all="ignore"):  # from simulations that are not finite, whose steps are rejected
            lane.put(going, advanced(lane.rows(going), new, gain, samples, kinds, np))
        given_up |= beaten(lane, records)
        going = np.flatnonzero(~lane.ended & ~given_up & (lane.steps < steps))
    return lane, given_up


def _of_records(stack: Stack, records: np.ndarray, most: int) -> tuple[Stack, np.ndarray]:
    """The problems of some records on the CPU, padded to a power of two up to `most`, and the place of each record, which may repeat."""
    among, place = np.unique(records, return_inverse=True)
    size = min(most, room(among.size))
    if among[-1] - among[0] < among.size <= size <= stack.count:  # contiguous: arrays are not copied
        begin = min(among[0], stack.count - size)
        return placed(stack.take(slice(begin, begin + size)), first_device("cpu")), records - begin
    rows = among[np.minimum(np.arange(size), among.size - 1)]
    return placed(stack.take(rows), first_device("cpu")), place


@compiled
def _linearized(stack: Stack, records: Array, z: Float[Array, "L p"], count: Array) -> tuple[Array, ...]:
    """Fields of the `Normal` at the first `count` points, one after another; zero at the others."""

    def one(k: Array, rows: Normal) -> Normal:
        new = normal_at(stack.at(records[k]), z[k])
        return jax.tree_util.tree_map(lambda all_rows, value: all_rows.at[k].set(value), rows, new)

    return tuple(jax.lax.fori_loop(0, count, one, _no_rows(*z.shape)))


@compiled
def _linearized_beside(stack: Stack, records: Array, z: Float[Array, "L p"], count: Array) -> tuple[Array, ...]:
    """`_linearized`, several lanes at a time for models that suit this."""
    if not suits_lanes(stack.at(0)):
        return _linearized(stack, records, z, count)
    lanes, p = z.shape
    width = min(BESIDE, lanes)

    def some(k: Array, rows: Normal) -> Normal:
        begin = jnp.minimum(k * width, lanes - width)
        at = lambda values: jax.lax.dynamic_slice_in_dim(values, begin, width)
        # A block of 256 samples fits in the cache: 0.92 of the time of blocks of 10 000 (Bouc-Wen).
        normal = functools.partial(normal_in_scan, block=256)
        new = stack.side_by_side(normal)(stack.take(at(records)), at(z))
        put = lambda all_rows, values: jax.lax.dynamic_update_slice_in_dim(all_rows, values, begin, 0)
        return jax.tree_util.tree_map(put, rows, new)

    return tuple(jax.lax.fori_loop(0, -(-count // width), some, _no_rows(lanes, p)))


def _no_rows(lanes: int, p: int) -> Normal:
    return Normal(jnp.zeros((lanes, p)), jnp.zeros(lanes), jnp.zeros((lanes, p)), jnp.zeros((lanes, p, p)))


def _together(stack: Stack, records: np.ndarray, lane: Lane, gain: Any, steps: int, device: Any) -> Lane:
    """Advance all lanes together on a device, which keeps the data; the last few lanes are left unfinished."""
    among, place = np.unique(records, return_inverse=True)
    rows = stack.take(among[np.minimum(np.arange(room(among.size)), among.size - 1)])
    data, going, most = placed(rows, device), np.arange(len(records)), room(len(records))
    sizes = [-(-most // part) for part in (_FEW, 8, 1)]  # each is compiled as a program of its own
    while going.size > most // _FEW:
        capacity = next(size for size in sizes if size >= going.size)
        at = going[np.minimum(np.arange(capacity), going.size - 1)]
        arguments = placed((place[at], lane.rows(at)), device)
        new = _advance_all(data, *arguments, gain, min(_ROUND, steps), _UNROLL)
        new = _first(new, going.size)
        lane.put(going, new)
        going = going[~new.ended & (new.steps < steps)]
    return lane


def _first(rows: Any, count: int) -> Any:
    """The first rows of arrays, as arrays of NumPy."""
    return jax.tree_util.tree_map(lambda values: np.asarray(values)[:count], rows)


def room(count: int) -> int:
    """The next power of two, so that few array lengths, and so few programs, occur."""
    return 1 << max(count - 1, 0).bit_length()


def placed(tree: Any, device: Any) -> Any:
    """Arrays on a device."""
    return jax.device_put(tree, device)


@functools.partial(jax.jit, static_argnums=(4, 5))
def _advance_all(stack: Stack, records: Array, lane: Lane, gain: Array, most: int, unroll: int) -> Lane:
    """All lanes after at most `most` steps."""
    in_scan = functools.partial(normal_in_scan, unroll=unroll)
    normal = in_scan if suits_one_scan(stack.at(0)) else normal_at
    samples, kinds = stack.samples, stack.kinds

    def some_steps(objective: Objective, lane: Lane) -> Lane:
        end = lane.steps + most
        once = lambda lane: advanced(lane, normal(objective, lane.trial), gain, samples, kinds, jnp)
        return jax.lax.while_loop(lambda lane: ~lane.ended & (lane.steps < end), once, lane)

    return stack.side_by_side(some_steps)(stack.take(records), lane)
