"""Models in series: the output of each is the input of the next."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import in_room
from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis, OutputResonance
from hystfit.models.composition import AbstractComposition, check_parts, join_c_parts, split_state
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import checked_drive, run
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.step_inverse import AbstractStepInverse, SearchStep
from hystfit.params.host_arrays import compiled, to_device


class Series(AbstractComposition):
    """The output of each model is the input of the next: a lag before, creep or a resonance after a hysteresis.

    Raises:
        ModelError: a part is not a model.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        check_parts(parts, 2, "Series")
        self.parts = parts

    def init(self, u0: Scalar) -> State:
        """States of the parts, then the signals between them."""
        states, between, signal = [], [], u0
        for part in self.parts:
            states.append(part.init(signal))
            signal = part.sweep(states[-1], signal, signal[None], jnp.zeros((1,)))[1][0]
            between.append(signal)
        return jnp.concatenate([*states, jnp.stack(between[:-1])])

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        states, between, signal = [], [], u1
        for part, s, old in self._chain(state, u0):
            s, signal = part.step(s, old, signal, dt)
            states.append(s)
            between.append(signal)
        return jnp.concatenate([*states, jnp.stack(between[:-1])]), signal

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """A scan for each part, over all that the part before it puts out."""
        return self._fed(state, u0, u, lambda part, *signals: part.sweep(*signals, dt))

    def _fed(
        self, state: Array, u0: Array, signal: Array, sweep: Callable[..., tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        states, between = [], []
        for part, s, old in self._chain(state, u0):
            s, signal = sweep(part, s, old, signal)
            states.append(s)
            between.append(signal[-1])
        return jnp.concatenate([*states, jnp.stack(between[:-1])]), signal

    def _chain(self, state: Array, u0: Array) -> list[tuple[AbstractHysteresis, Array, Array]]:
        """Every part, its state, and the input that it had last."""
        edge = state.shape[0] - len(self.parts) + 1
        return list(zip(self.parts, split_state(state[:edge], self.parts), [u0, *state[edge:]], strict=True))

    def start(self, records: Sequence[Record]) -> Series:
        """Starting values of each part come from the output of the part before it and the measured output."""
        return self.starting_points(records)[0]

    def starting_points(self, records: Sequence[Record]) -> tuple[Series, ...]:
        """Those with each starting point of every part, in their order."""
        chains: list[tuple[tuple[AbstractHysteresis, ...], list[Record]]] = [((), list(records))]
        for k, part in enumerate(self.parts):
            points = [
                ((*made, point), arriving) for made, arriving in chains for point in part.starting_points(arriving)
            ]
            ends = k == len(self.parts) - 1
            chains = [(made, arriving if ends else _behind(made[-1], arriving)) for made, arriving in points]
        return tuple(type(self)(*made) for made, _ in chains)

    def step_errors(self, records: Sequence[Record]) -> Series:
        """Those of each part on the output of the part before it."""
        arriving = itertools.accumulate(
            self.parts[:-1], lambda records, part: _behind(part, records), initial=list(records)
        )
        return type(self)(*(part.step_errors(of) for part, of in zip(self.parts, arriving, strict=True)))

    def _with_rest_sample(self, u: Any, dt: Any) -> tuple[np.ndarray, np.ndarray]:
        """The input with one more sample before the first, so that each part starts from its own rest, as in `init`."""
        u, dt = (np.asarray(values) for values in checked_drive(self, u, dt))
        return np.append(u[0], u), np.append(0.0, dt)

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        if not self.has_fast_run:
            return super().free_run(u, dt)
        signal, steps = self._with_rest_sample(u, dt)
        for part in self.parts:
            signal = part.free_run(signal, steps)
        return signal[1:]

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """That of the first part, and of the others where it only filters the input."""
        first, *others = self.parts
        if not first.linear_in_input:
            return first.advice(u, dt)
        filtered = first.free_run(u) if first.rate_independent else u
        return (*first.advice(u, dt), *(line for part in others for line in part.advice(filtered, dt)))

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of the first part that only linear filters follow, through these filters."""
        number = len(self.parts) - 1
        while number and self.parts[number].linear_in_input:
            number -= 1
        signal, steps = self._with_rest_sample(u, dt)
        for part in self.parts[:number]:
            signal = part.free_run(signal, steps)
        design = self.parts[number].design_matrix(signal, steps)
        for part in self.parts[number + 1 :]:
            design = _filter_design(part, design.rows(), steps)
        return DesignMatrix(tuple(self._blocks(number, design.blocks)), design.rest, design.index[1:])

    def reach(self) -> tuple[float, float] | None:
        """That of the first part that has one."""
        for k, part in enumerate(self.parts):
            if (edges := part.reach()) is not None:
                return functools.reduce(
                    lambda edges, before: before.inputs_between(*edges), self.parts[:k][::-1], edges
                )
        return None

    def output_resonance(self) -> OutputResonance | None:
        """The resonance of the last part, and the parts before it."""
        last = self.parts[-1].output_resonance()
        if last is None:
            return None
        before = [*self.parts[:-1], *(() if last.model is None else (last.model,))]
        return OutputResonance(before[0] if len(before) == 1 else Series(*before), last.omega, last.zeta)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """Bounds; None where two parts are no filters, because the range of inputs of the second is not known."""
        if sum(not part.linear_in_input for part in self.parts) > 1:
            return None
        total = Slopes(1.0, 1.0)
        for part in self.parts:
            found = part.slope_range(low, high, dt)
            if found is None:
                return None
            low, high = (-high, -low) if found.most < 0 else (low, high)
            total = found.after(total)
        return total

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """Those of the parts, from the last to the first; a search where a part needs limits and has no range."""
        inner = tuple(part.step_inverse() for part in self.parts)
        open_ = (-np.inf, np.inf)
        ranges = [part.reach() if s.needs_limits else open_ for s, part in zip(inner, self.parts, strict=True)]
        if any(edges is None for edges in ranges[1:]):
            return SearchStep(self, sign)
        return SeriesStep(self, inner, to_device([edges or open_ for edges in ranges]))

    def c_part(self) -> CPart:
        """Feeds the output of each part into the next."""

        def lines(k: int, at: int, total: int) -> tuple[str, str]:
            step = f"    y = @f@{k}_step(s + {at}, before, signal, dt, next ? next + {at} : 0);\n"
            if k == len(self.parts) - 1:
                return "", step
            init = f"    signal = @f@{k}_step(s + {at}, signal, signal, 0.0, 0);\n    s[{total + k}] = signal;\n"
            step += (
                f"    before = s[{total + k}];\n    signal = y;\n    if (next)\n        next[{total + k}] = signal;\n"
            )
            return init, step

        return join_c_parts(self.parts, "Each output is the next one's input.", lines, len(self.parts) - 1)


class SeriesStep(AbstractStepInverse):
    """Inverses of the parts of a `Series`, from the last to the first; each but the first searches between its limits (`edges`)."""

    model: Series
    inner: tuple[AbstractStepInverse, ...]
    edges: Float[Array, "parts two"]

    @property
    def needs_limits(self) -> bool:
        """As its first part."""
        return self.inner[0].needs_limits

    @property
    def sign(self) -> float:
        """The product of those of its parts."""
        return math.prod(step.sign for step in self.inner)

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        count = len(self.inner) - 1
        states = split_state(state, self.model.parts)
        before = [u0, *(state[state.shape[0] - count + k] for k in range(count))]
        rising: Array = jnp.asarray(True)
        for k in range(count, 0, -1):
            target, fine = self.inner[k].solve(states[k], before[k], target, dt, *self.edges[k])
            rising = rising & fine
        u1, fine = self.inner[0].solve(states[0], u0, target, dt, low, high)
        return Root(u1, rising & fine)


def _behind(part: AbstractHysteresis, records: Sequence[Record]) -> list[Record]:
    """Records whose input is the output of a part over them."""
    return [r.replace(u=part.free_run(r.u, r.dt)) for r in records]


def _filter_design(part: AbstractHysteresis, design: DesignMatrix, dt: np.ndarray) -> DesignMatrix:
    """A design matrix, one row per sample, through a filter that is linear in its input."""
    columns = [block.columns for block in design.blocks]
    signals = np.column_stack([design.rest, *columns])
    if (out := part.filtered(signals, dt)) is None:
        steps = in_room(np.asarray(dt))
        wide = np.pad(signals, ((0, steps.size - len(signals)), (0, 0)), mode="edge")
        out = np.asarray(_filtered(part, wide, steps, np.int64(len(signals))))[: len(signals)]
    edges = np.cumsum([1, *(block.shape[1] for block in columns)])
    blocks = (
        dataclasses.replace(block, columns=out[:, lo:hi])
        for block, (lo, hi) in zip(design.blocks, itertools.pairwise(edges), strict=True)
    )
    return DesignMatrix(tuple(blocks), out[:, 0], design.index)


@compiled
def _filtered(part: Any, signals: Array, dt: Array, count: Array) -> Array:
    """Outputs for each column of signals, shape (T, p); for all but the first, minus the response of the initial state."""
    response = lambda signal: run(part, signal, dt, count=count)[0]
    outputs = jax.vmap(response, in_axes=1, out_axes=1)(signals)
    constant = response(jnp.zeros_like(dt))
    return outputs.at[:, 1:].add(-constant[:, None])
