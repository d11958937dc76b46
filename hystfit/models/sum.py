"""Models of one input whose outputs add up."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.composition import AbstractComposition, check_parts, join_c_parts, split_state
from hystfit.models.offset import Offset
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.step_inverse import AbstractStepInverse, SearchStep


class Sum(AbstractComposition):
    """Outputs of several models of the same input, added: a hysteresis, its creep, a viscous force.

    Raises:
        ModelError: a part is not a model.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        check_parts(parts, 1, "Sum")
        self.parts = parts

    def init(self, u0: Scalar) -> State:
        """States of the parts, one after another."""
        return jnp.concatenate([part.init(u0) for part in self.parts])

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        steps = [part.step(s, u0, u1, dt) for part, s in zip(self.parts, split_state(state, self.parts), strict=True)]
        return jnp.concatenate([s for s, _ in steps]), sum((y for _, y in steps), jnp.zeros_like(u1))

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """A scan for each part: a loop over all at once touches too much to be compiled into one piece."""
        runs = [part.sweep(s, u0, u, dt) for part, s in zip(self.parts, split_state(state, self.parts), strict=True)]
        return jnp.concatenate([s for s, _ in runs]), sum((y for _, y in runs), jnp.zeros_like(u))

    def start(self, records: Sequence[Record]) -> Sum:
        """Starting values of each part come from the residuals of the parts before it."""
        started, remaining = [], list(records)
        for part in self.parts:
            if started:
                outputs = [started[-1].free_run(r.u, r.dt) for r in remaining]
                remaining = [r.replace(y=r.y - y) for r, y in zip(remaining, outputs, strict=True)]
            started.append(part.start(remaining))
        return type(self)(*started)

    def step_errors(self, records: Sequence[Record]) -> Sum:
        """Those of each part on the residuals of the others."""
        outputs = [[part.free_run(r.u, r.dt) for part in self.parts] for r in records]
        rest = lambda k: [r.replace(y=r.y - sum(of) + of[k]) for r, of in zip(records, outputs, strict=True)]
        return type(self)(*(part.step_errors(rest(k)) for k, part in enumerate(self.parts)))

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        if not self.has_fast_run:
            return super().free_run(u, dt)
        u, dt = checked_drive(self, u, dt)
        return np.sum([part.free_run(u, dt) for part in self.parts], axis=0)

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """That of all parts."""
        return tuple(line for part in self.parts for line in part.advice(u, dt))

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of all parts, one row per sample."""
        u, dt = checked_drive(self, u, dt)
        designs = [part.design_matrix(u, dt).rows() for part in self.parts]
        blocks = [block for k, design in enumerate(designs) for block in self._blocks(k, design.blocks)]
        return DesignMatrix(tuple(blocks), np.sum([design.rest for design in designs], axis=0), np.arange(u.size))

    def reach(self) -> tuple[float, float] | None:
        """Where the ranges of all parts overlap."""
        ranges = [edges for part in self.parts if (edges := part.reach()) is not None]
        return (max(low for low, _ in ranges), min(high for _, high in ranges)) if ranges else None

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Bounds: the extremes of the parts need not meet on one branch."""
        parts = [part.slope_range(low, high, dt) for part in self.parts]
        known = [part for part in parts if part is not None]
        return functools.reduce(operator.add, known) if len(known) == len(parts) else None

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """That of the only part that is not constant; else a search."""
        moving = [k for k, part in enumerate(self.parts) if not isinstance(part, Offset)]
        inverses = [self.parts[k].step_inverse(sign) for k in moving]  # refuses parts that have none
        return SumStep(self, inverses[0], moving[0]) if len(moving) == 1 else SearchStep(self, sign)

    def c_part(self) -> CPart:
        """Adds the outputs of the parts."""
        line = "    y += @f@{k}_step(s + {at}, before, signal, dt, next ? next + {at} : 0);\n"
        return join_c_parts(self.parts, "Outputs add up.", lambda k, at, total: ("", line.format(k=k, at=at)), 0)


class SumStep(AbstractStepInverse):
    """Inverse of a sum of one model, number `which`, and constants."""

    model: Sum
    inner: AbstractStepInverse
    which: int = eqx.field(static=True)

    @property
    def needs_limits(self) -> bool:
        """As the part."""
        return self.inner.needs_limits

    @property
    def sign(self) -> float:
        """As the part."""
        return self.inner.sign

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        constants = [part.value for k, part in enumerate(self.model.parts) if k != self.which]  # type: ignore[attr-defined]
        inner_state = split_state(state, self.model.parts)[self.which]
        return self.inner.solve(inner_state, u0, target - sum(constants), dt, low, high)
