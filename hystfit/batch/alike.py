"""Loops of one structure, as a map or a folder has them: their problems differ in numbers alone, and are solved together.

Loops over one input, such as those of a map, share its arrays. Records over inputs of their own are groups of one loop each.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from hystfit.batch.bucketed import solve_stack
from hystfit.data.batch import bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, set_up_fit
from hystfit.fitting.solvers.lanes import Ends, Stack
from hystfit.fitting.solvers.multistart import spread_starts
from hystfit.fitting.solvers.thinning import LEAST, kept_samples
from hystfit.inference.objective import Objective
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.starting import scales_of
from hystfit.params.host_arrays import zeros
from hystfit.params.units import Scales

CONVEX = ("convex", "preisach")  # estimators of weights, which are solved side by side
_FIRST = 2  # loops from whose starting values all others begin: with 1, 2 and 3 the same loops of 1024 were left to further starts
_LOOKED_AT = 512  # loops among which these are chosen
# Steps of each start that is read off a loop, before the best one goes on: a loop that is not described from it is solved from all starts.
_GLANCE = 3


def same_columns(a: Record, b: Record, *names: str) -> bool:
    """Whether two records have equal columns of these names."""
    pairs = ((getattr(a, name), getattr(b, name)) for name in names)
    return all(one is other or np.array_equal(one, other) for one, other in pairs)


@dataclasses.dataclass(frozen=True)
class Group:
    """Loops over one input: a record with its numbers and labels, and their outputs, shape (N, T)."""

    record: Record
    y: Float[np.ndarray, "N T"]

    @functools.cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest of each output."""
        y = self.y if self.record.used.all() else self.y[:, self.record.used]
        return y.min(axis=1), y.max(axis=1)

    @functools.cached_property
    def sizes(self) -> Float[np.ndarray, "N 3"]:
        """Natural sizes of input, output and time of each loop."""
        (low, high), scales = self._ends, scales_of(Dataset.of(self.record))
        same = np.tile([scales.u, 1.0, scales.s], (len(low), 1))
        same[:, 1] = 0.5 * (high - low)
        return same

    @property
    def levels(self) -> Float[np.ndarray, " N"]:
        """Middle of each output over its half range."""
        low, high = self._ends
        return (high + low) / (high - low)

    def take(self, rows: np.ndarray) -> Group:
        """Some of the loops, whose numbers rise."""
        return self if len(rows) == len(self.y) else Group(self.record, self.y[rows])


@dataclasses.dataclass(frozen=True)
class Loops:
    """Loops in groups of one input each, one group after another, padded to a common length."""

    groups: tuple[Group, ...]

    def __len__(self) -> int:
        return sum(len(group.y) for group in self.groups)

    def each(self, function: Callable[..., Any], *rows: np.ndarray) -> Any:
        """What a function gives for each group and its rows of some arrays, an array or a tuple of them, for all loops."""
        stops = np.cumsum([len(group.y) for group in self.groups])
        parts = [
            function(group, *(row[stop - len(group.y) : stop] for row in rows))
            for group, stop in zip(self.groups, stops.tolist(), strict=True)
        ]
        if not isinstance(parts[0], tuple):
            return np.concatenate(parts)
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))

    def take(self, rows: np.ndarray) -> Loops:
        """Some of the loops; `rows` are their numbers, rising."""
        stops = np.cumsum([0, *(len(group.y) for group in self.groups)])
        edges = np.searchsorted(rows, stops)
        pairs = zip(self.groups, stops.tolist(), edges.tolist(), edges[1:].tolist(), strict=False)
        return Loops(tuple(group.take(rows[a:b] - start) for group, start, a, b in pairs if b > a))

    @functools.cached_property
    def length(self) -> int:
        """Samples of a padded loop."""
        return bucket(max(len(group.record) for group in self.groups))

    def columns(self, kept: Sequence[np.ndarray] | None, length: int) -> tuple[np.ndarray, ...]:
        """u, dt and weight of each group, shape (G, 1, length), and y of each loop, shape (N, 1, length), padded as in `Batch`.

        One row of dt and weight where all groups have the same. `kept` are numbers of the samples of each group; None for all.
        """
        first = self.groups[0].record
        same = kept is None and all(same_columns(group.record, first, "t", "weight", "used") for group in self.groups)
        u, y = zeros(len(self.groups), 1, length), zeros(len(self), 1, length)
        dt, weight = (zeros(1 if same else len(self.groups), 1, length) for _ in range(2))
        start = 0
        for k, group in enumerate(self.groups):
            record, at = group.record, slice(None) if kept is None else kept[k]
            inputs = record.u[at]
            of_record = slice(inputs.size)
            u[k, 0, of_record], u[k, 0, inputs.size :] = inputs, record.u[-1]
            y[start : start + len(group.y), 0, of_record] = group.y[:, at]
            start += len(group.y)
            if k < len(dt):
                dt[k, 0, of_record] = record.dt if kept is None else np.diff(np.cumsum(record.dt)[at], prepend=0.0)
                weight[k, 0, of_record] = np.where(record.used[at], record.weight[at], 0.0)
        return u, dt, weight, y


class Common(NamedTuple):
    """What the loops have in common."""

    setup: FitSetup  # the fit of one of them
    starts: np.ndarray  # shape (S, p), relative to the sizes of each loop; none for weights, which need none
    levels: np.ndarray  # middle of the output over its half range, of the loop that each start is from, shape (S,)
    powers: np.ndarray  # of the sizes of input, output and time in the scale of each parameter, shape (3, p)
    read: int = 0  # how many of the starts, the first ones, are read off loops; the others surround them

    @property
    def of_weights(self) -> bool:
        """Whether the model is linear in all free parameters, which are found by convex optimization."""
        return self.setup.method in CONVEX

    def scale(self, loops: Loops) -> Float[np.ndarray, "N p"]:
        """Natural scale of each parameter of each loop."""
        own = self.setup.problem
        ratio = loops.each(lambda group: group.sizes) / [own.scales.u, own.scales.y, own.scales.s]
        return own.space.scale * np.exp(np.log(ratio) @ self.powers)

    def stack(self, loops: Loops, kept: Sequence[np.ndarray] | None = None, length: int | None = None) -> Stack:
        """The problems of loops, on all samples or on some."""
        on_host: Objective = jax.tree_util.tree_map(np.asarray, self.setup.problem.objective)
        u, dt, weight, y = loops.columns(kept, length or loops.length)
        sizes = loops.each(lambda group: group.sizes)[:, 1]
        inputs = lambda o: (o.batch.u, o.batch.dt, o.batch.weight)
        places = lambda o: (o.batch.y, o.coordinates.scale, o.size)
        own = eqx.tree_at(places, jax.tree_util.tree_map(lambda _: False, on_host), (True, True, True))
        differ = [any((row != rows[0]).any() for row in rows) for rows in (u, dt, weight)]
        of_loop = np.repeat(np.arange(len(u)), [len(group.y) for group in loops.groups])
        of_all = lambda rows: rows if len(rows) == len(y) else rows[of_loop]
        columns = [of_all(rows) if apart else rows[0] for rows, apart in zip((u, dt, weight), differ, strict=True)]
        own = eqx.tree_at(inputs, own, tuple(differ))
        on_host = eqx.tree_at(inputs, on_host, tuple(columns))
        on_host = eqx.tree_at(places, on_host, (y, self.scale(loops), sizes))
        return Stack(on_host, tuple(jax.tree_util.tree_leaves(own)))

    def starts_of(self, loops: Loops) -> Float[np.ndarray, "N S p"]:
        """Starts of each loop, about the middle of its output."""
        starts = np.repeat(self.starts[None], len(loops), axis=0)
        higher = loops.each(lambda group: group.levels)[:, None] - self.levels
        starts[:, :, self.setup.problem.space.offsets] += higher[..., None]
        return starts


def common_of(model: AbstractHysteresis, loops: Loops, options: FitOptions, *, held: bool) -> Common | None:
    """What loops with faultless outputs have in common; None where their fits differ in more than numbers. `held`: see `set_up_fit`."""
    chosen = _different(loops)
    setups = [set_up_fit(model, Dataset.of(record), options, held=held) for record in chosen]
    first = setups[0]
    alike = all(
        one.method == first.method
        and one.problem.space.names == first.problem.space.names
        and [p[:2] for p in one.problem.space.fixed()] == [p[:2] for p in first.problem.space.fixed()]
        and np.array_equal(one.problem.space.lower, first.problem.space.lower)
        and np.array_equal(one.problem.space.upper, first.problem.space.upper)
        and len(one.problem.data[0]) == len(record)
        and np.array_equal(one.problem.data[0].weight, record.weight)
        and jax.tree_util.tree_structure(one.problem.objective) == jax.tree_util.tree_structure(first.problem.objective)
        for one, record in zip(setups, chosen, strict=True)
    )
    found = first.problem.model
    if not alike or found.derived() or type(found).hysteretic_share is not AbstractHysteresis.hysteretic_share:
        return None
    of_weights = first.method in CONVEX
    if of_weights and not (first.problem.closed_form and len(loops.groups) == 1):
        return None
    if not of_weights and first.method != "lm":
        return None
    none = np.zeros((0, len(first.problem.space))), np.zeros(0), 0
    starts, levels, read = none if of_weights else _starts(setups, options)
    unit = Scales(1.0, 1.0, 1.0)
    doubled = [dataclasses.replace(unit, **{symbol: 2.0}) for symbol in "uys"]
    units = [info.unit for info in first.problem.space.infos]
    powers = np.log2([[sizes.size(one) / unit.size(one) for one in units] for sizes in doubled])
    return Common(first, starts, levels, np.round(powers, 9), read)


def _different(loops: Loops) -> list[Record]:
    """Records of a few loops unlike each other, each beside its own range; the first is a typical one."""
    chosen = np.linspace(0, len(loops) - 1, min(len(loops), _LOOKED_AT)).astype(int)
    some = loops.take(chosen)
    samples = min(min(len(group.record) for group in some.groups), LEAST)

    def shape(group: Group) -> np.ndarray:
        at = np.linspace(0, len(group.record) - 1, samples).astype(int)
        y = group.y
        return (y[:, at] - 0.5 * (y.min(axis=1) + y.max(axis=1))[:, None]) / np.ptp(y, axis=1)[:, None]

    shapes = some.each(shape)
    far = np.linalg.norm(shapes - np.median(shapes, axis=0), axis=1)
    first = [int(np.argmin(far))]
    while len(first) < min(_FIRST, len(some)):
        apart = np.min([np.linalg.norm(shapes - shapes[k], axis=1) for k in first], axis=0)
        first.append(int(np.argmax(apart)))
    single = [some.take(np.array([k])).groups[0] for k in first]
    return [group.record.replace(y=group.y[0]) for group in single]


def _starts(setups: list[FitSetup], options: FitOptions) -> tuple[np.ndarray, np.ndarray, int]:
    """Starts from all setups, and a hypercube about the first; the level of the output that each belongs to; how many are from setups."""
    rows, levels = [], []
    for setup in setups:
        space, record = setup.problem.space, setup.problem.data[0]
        level = 0.5 * (record.y[record.used].max() + record.y[record.used].min()) / setup.problem.scales.y
        for model in setup.points[: options.starts]:
            rows.append(space.unconstrained(space.clip(space.vector(model))))
            levels.append(level)
    spread = spread_starts(setups[0].problem, rows[0], options.starts - len(rows) + 1, options.seed)[1:]
    return np.stack([*rows, *spread]), np.array([*levels, *[levels[0]] * len(spread)]), len(rows)


def solve_alike(common: Common, loops: Loops) -> tuple[Ends, Stack]:
    """Where the best start that is read off a loop ended, for each of them (finite, without faults), and their problems."""
    full, short = common.stack(loops), None
    if common.setup.problem.model.allows_thinning:
        found = kept_samples([group.record for group in loops.groups], loops.length, LEAST)
        short = None if found is None else common.stack(loops, *found)
    return solve_stack(full, short, common.starts_of(loops)[:, : common.read], _GLANCE)[0], full
