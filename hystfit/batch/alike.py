"""Loops over one input, as a map has them: their problems differ in the output alone, and are solved together from common starts."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from hystfit.batch.bucketed import solve_stack
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, set_up_fit
from hystfit.fitting.lanes import Ends, Stack
from hystfit.fitting.multistart import spread_starts
from hystfit.fitting.thinning import kept_samples
from hystfit.inference.objective import Objective
from hystfit.models.base import AbstractHysteresis
from hystfit.params.units import Scales

_FIRST = 3  # loops from whose starting values all others begin
_LOOKED_AT = 512  # loops among which these are chosen
_GLANCE = 3  # steps of every start, before the best one goes on: a loop that is not described from it is fitted alone, from all
_SHORT = 256  # samples on which starts are compared, and loops are compared with each other


class Common(NamedTuple):
    """What the loops have in common.

    Attributes:
        setup: the fit of one of them.
        starts: shape (S, p), relative to the size of each output.
        levels: middle of the output over its half range, of the loop that each start is from, shape (S,).
        powers: of the output's size in the scale of each parameter, shape (p,).
    """

    setup: FitSetup
    starts: np.ndarray
    levels: np.ndarray
    powers: np.ndarray

    @property
    def record(self) -> Record:
        """The loop of the setup."""
        return self.setup.problem.data[0]

    def sizes(self, y: Float[np.ndarray, "N T"]) -> Float[np.ndarray, " N"]:
        """Half ranges of outputs."""
        used = self.record.used
        return 0.5 * np.ptp(y[:, used], axis=1)

    def scale(self, y: Float[np.ndarray, "N T"]) -> Float[np.ndarray, "N p"]:
        """Natural scale of each parameter of each loop."""
        own = self.setup.problem
        return own.space.scale * (self.sizes(y) / own.scales.y)[:, None] ** self.powers

    def stack(self, y: Float[np.ndarray, "N T"], kept: np.ndarray | None = None) -> Stack:
        """The problems of loops, on all samples or on some."""
        on_host: Objective = jax.tree_util.tree_map(np.asarray, self.setup.problem.objective)
        scale, size = self.scale(y), self.sizes(y)
        if kept is not None:
            count, batch = len(self.record), on_host.batch
            u, dt, weight = (rows[0, :count] for rows in (batch.u, batch.dt, batch.weight))
            rows = u[kept], np.diff(np.cumsum(dt)[kept], prepend=0.0), weight[kept]
            short = lambda o: (o.batch.u, o.batch.dt, o.batch.weight)
            on_host, y = eqx.tree_at(short, on_host, tuple(row[None] for row in rows)), y[:, kept]
        padded = np.zeros((len(y), 1, on_host.batch.u.shape[1]))
        padded[:, 0, : y.shape[1]] = y
        places = lambda o: (o.batch.y, o.coordinates.scale, o.size)
        own = eqx.tree_at(places, jax.tree_util.tree_map(lambda _: False, on_host), (True, True, True))
        return Stack(eqx.tree_at(places, on_host, (padded, scale, size)), tuple(jax.tree_util.tree_leaves(own)))


def common_of(
    model: AbstractHysteresis, record: Record, y: Float[np.ndarray, "N T"], options: FitOptions, *, held: bool
) -> Common | None:
    """What loops over the input of a record have in common; None where their fits differ in more than the output.

    Args:
        model: that is fitted.
        record: gives input, time, weights and units.
        y: outputs without faults.
        options: of each fit.
        held: parameters in `fix` without a value keep that of the model.
    """
    chosen = _different(y[np.linspace(0, len(y) - 1, min(len(y), _LOOKED_AT)).astype(int)])
    setups = [set_up_fit(model, Dataset.of(record.replace(y=row)), options, held=held) for row in chosen]
    first = setups[0]
    alike = all(
        one.method == "lm" == first.method
        and one.problem.space.names == first.problem.space.names
        and [p[:2] for p in one.problem.space.fixed()] == [p[:2] for p in first.problem.space.fixed()]
        and len(one.problem.data[0]) == len(record)
        and np.array_equal(one.problem.data[0].weight, first.problem.data[0].weight)
        and jax.tree_util.tree_structure(one.problem.objective) == jax.tree_util.tree_structure(first.problem.objective)
        for one in setups
    )
    if not alike or first.problem.model.derived():
        return None
    starts, levels = _starts(setups, options)
    infos, scales = first.problem.space.infos, first.problem.scales
    doubled = Scales(scales.u, 2.0, scales.s)
    single = dataclasses.replace(doubled, y=1.0)
    powers = np.log2([doubled.size(info.unit) / single.size(info.unit) for info in infos])
    return Common(first, starts, levels, np.round(powers, 9))


def _different(y: Float[np.ndarray, "N T"]) -> np.ndarray:
    """A few loops unlike each other, each beside its own range; the first is a typical one."""
    at = np.linspace(0, y.shape[1] - 1, min(y.shape[1], _SHORT)).astype(int)
    shapes = y[:, at] - 0.5 * (y.min(axis=1) + y.max(axis=1))[:, None]
    shapes = shapes / np.ptp(y, axis=1)[:, None]
    far = np.linalg.norm(shapes - np.median(shapes, axis=0), axis=1)
    chosen = [int(np.argmin(far))]
    while len(chosen) < min(_FIRST, len(y)):
        apart = np.min([np.linalg.norm(shapes - shapes[k], axis=1) for k in chosen], axis=0)
        chosen.append(int(np.argmax(apart)))
    return y[chosen]


def _starts(setups: list[FitSetup], options: FitOptions) -> tuple[np.ndarray, np.ndarray]:
    """Starts from all setups, and a hypercube about the first; and the level of the output that each belongs to."""
    rows, levels = [], []
    for setup in setups:
        space, record = setup.problem.space, setup.problem.data[0]
        level = 0.5 * (record.y[record.used].max() + record.y[record.used].min()) / setup.problem.scales.y
        for model in setup.points[: options.starts]:
            rows.append(space.unconstrained(space.clip(space.vector(model))))
            levels.append(level)
    spread = spread_starts(setups[0].problem, rows[0], options.starts - len(rows) + 1, options.seed)[1:]
    return np.stack([*rows, *spread]), np.array([*levels, *[levels[0]] * len(spread)])


def solve_alike(common: Common, y: Float[np.ndarray, "N T"]) -> tuple[Ends, Stack]:
    """Where the best start of each loop ended, and their problems.

    Args:
        common: what they have in common.
        y: outputs without faults, finite.
    """
    problem = common.setup.problem
    full, kept = common.stack(y), kept_samples(problem, _SHORT)
    short = None if kept is None else common.stack(y, kept[0])
    used = problem.data[0].used
    level = 0.5 * (y[:, used].max(axis=1) + y[:, used].min(axis=1)) / np.asarray(full.objective.size)
    starts = np.repeat(common.starts[None], len(y), axis=0)
    starts[:, :, problem.space.offsets] += (level[:, None] - common.levels)[..., None]
    return solve_stack(full, short, starts, _GLANCE)[0], full
