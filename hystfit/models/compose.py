"""Compositions of models: `Sum` adds their outputs, `Series` feeds each output into the next model."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import (
    AbstractHysteresis,
    AbstractStepInverse,
    Derived,
    OutputResonance,
    PlayWeights,
    SearchStep,
    drive,
    run,
    simulate,
)
from hystfit.models.bracketed import Root
from hystfit.models.c_code import CPart, template
from hystfit.models.design import Block, DesignMatrix
from hystfit.params.param import param


def _size(model: AbstractHysteresis) -> int:
    return jax.eval_shape(model.init, jnp.zeros(())).shape[0]


def _split(state: Array, parts: Sequence[AbstractHysteresis]) -> list[Array]:
    """States of the parts of a composition, which come first in its state, one after another."""
    edges = np.cumsum([0, *(_size(part) for part in parts)])
    return [state[lo:hi] for lo, hi in itertools.pairwise(edges)]


def _check_parts(parts: Sequence[AbstractHysteresis], least: int, name: str) -> None:
    if len(parts) < least or not all(isinstance(part, AbstractHysteresis) for part in parts):
        raise ModelError(f"{name} needs at least {least} models, got {[type(part).__name__ for part in parts]}")


class AbstractComposition(AbstractHysteresis):
    """Methods that `Sum` and `Series` delegate to their parts in the same way."""

    parts: eqx.AbstractVar[tuple[AbstractHysteresis, ...]]

    one_scan: ClassVar[bool] = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(repr(part) for part in self.parts)})"

    @property
    def rate_independent(self) -> bool:
        """Whether all parts are."""
        return all(part.rate_independent for part in self.parts)

    @property
    def allows_thinning(self) -> bool:
        """Whether all parts do."""
        return all(part.allows_thinning for part in self.parts)

    @property
    def has_fast_run(self) -> bool:
        """Whether some part has one."""
        return any(part.has_fast_run for part in self.parts)

    @property
    def linear_in_input(self) -> bool:
        """Whether all parts are."""
        return all(part.linear_in_input for part in self.parts)

    @property
    def causal(self) -> bool:
        """Whether all parts are."""
        return all(part.causal for part in self.parts)

    def prepared(self, record: Record) -> Record:
        """As all parts need it."""
        return functools.reduce(lambda prepared, part: part.prepared(prepared), self.parts, record)

    def derived(self) -> tuple[Derived, ...]:
        """Those of all parts."""
        of_part = lambda k, value: lambda model: value(model.parts[k])
        return tuple(d._replace(value=of_part(k, d.value)) for k, part in enumerate(self.parts) for d in part.derived())

    def plays(self) -> tuple[PlayWeights, ...]:
        """Those of all parts."""
        return tuple(one for part in self.parts for one in part.plays())

    def plane(self) -> Any:
        """That of the first part that has one."""
        return next((plane for part in self.parts if (plane := part.plane()) is not None), None)

    @property
    def estimator(self) -> str | None:
        """That of the first part that names one."""
        return next((part.estimator for part in self.parts if part.estimator is not None), None)

    @property
    def has_rest(self) -> bool:
        """Whether some part has one."""
        return any(part.has_rest for part in self.parts)

    @property
    def from_saturation(self) -> bool:
        """Whether some part starts there."""
        return any(part.from_saturation for part in self.parts)

    def with_rest(self, rest: str) -> AbstractHysteresis:
        """See the base class."""
        return type(self)(*(part.with_rest(rest) for part in self.parts))

    def without_creep(self) -> AbstractHysteresis | None:
        """See the base class."""
        still = [part.without_creep() for part in self.parts]
        if all(part is None for part in still):
            return None
        return type(self)(*(part if other is None else other for part, other in zip(self.parts, still, strict=True)))

    def sizes(self, records: Sequence[Record]) -> dict[str, AbstractHysteresis]:
        """Those of the first part that has a choice, on the records as they are: no part changes the number of samples or levels."""
        for k, part in enumerate(self.parts):
            if found := part.sizes(records):
                return {
                    words: type(self)(*self.parts[:k], other, *self.parts[k + 1 :]) for words, other in found.items()
                }
        return {}

    def _blocks(self, number: int, blocks: Sequence[Block]) -> list[Block]:
        """Blocks of one part, numbered among the leaves of the composition."""
        before = sum(len(jax.tree_util.tree_leaves(part)) for part in self.parts[:number])
        return [dataclasses.replace(block, leaf=block.leaf + before) for block in blocks]


class Sum(AbstractComposition):
    """Outputs of several models of the same input, added: a hysteresis, its creep, a viscous force.

    Raises:
        ModelError: a part is no model.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        _check_parts(parts, 1, "Sum")
        self.parts = parts

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """States of the parts, one after another."""
        return jnp.concatenate([part.init(u0) for part in self.parts])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample of every part."""
        steps = [part.step(s, u0, u1, dt) for part, s in zip(self.parts, _split(state, self.parts), strict=True)]
        return jnp.concatenate([s for s, _ in steps]), sum((y for _, y in steps), jnp.zeros_like(u1))

    def sweep(
        self,
        state: Float[Array, " state"],
        u0: Float[Array, ""],
        u: Float[Array, " T"],
        dt: Float[Array, " T"],
        unroll: int = 1,
    ) -> tuple[Float[Array, " state"], Float[Array, " T"]]:
        """A scan for each part: a loop over all at once touches too much to be compiled into one piece."""
        runs = [part.sweep(s, u0, u, dt, unroll) for part, s in zip(self.parts, _split(state, self.parts), strict=True)]
        return jnp.concatenate([s for s, _ in runs]), sum((y for _, y in runs), jnp.zeros_like(u))

    def start(self, records: Sequence[Record]) -> Sum:
        """Starting values of each part come from the residuals of the parts before it."""
        started, remaining = [], list(records)
        for part in self.parts:
            started.append(part.start(remaining))
            outputs = [np.asarray(simulate(started[-1], r.u, r.dt)[0]) for r in remaining]
            remaining = [r.replace(y=r.y - y) for r, y in zip(remaining, outputs, strict=True)]
        return type(self)(*started)

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """Part by part, where some part has a short cut."""
        if not self.has_fast_run:
            return super().free_run(u, dt)
        u, dt = drive(self, u, dt)
        return np.sum([part.free_run(u, dt) for part in self.parts], axis=0)

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """That of all parts."""
        return tuple(line for part in self.parts for line in part.advice(u, dt))

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of all parts, one row a sample."""
        u, dt = drive(self, u, dt)
        designs = [part.design_matrix(u, dt).rows() for part in self.parts]
        blocks = [block for k, design in enumerate(designs) for block in self._blocks(k, design.blocks)]
        return DesignMatrix(tuple(blocks), np.sum([design.rest for design in designs], axis=0), np.arange(u.size))

    def reach(self) -> tuple[float, float] | None:
        """Where the ranges of all parts overlap."""
        ranges = [edges for part in self.parts if (edges := part.reach()) is not None]
        return (max(low for low, _ in ranges), min(high for _, high in ranges)) if ranges else None

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """That of the only part that is not constant; else a search."""
        moving = [k for k, part in enumerate(self.parts) if not isinstance(part, Offset)]
        inverses = [self.parts[k].step_inverse(sign) for k in moving]  # refuses parts that have none
        return SumStep(self, inverses[0], moving[0]) if len(moving) == 1 else SearchStep(self, sign)

    def c_part(self) -> CPart:
        """Adds the outputs of the parts."""
        line = "    y += @f@{k}_step(s + {at}, before, signal, dt, next ? next + {at} : 0);\n"
        return _join_c_parts(self.parts, "Outputs add up.", lambda k, at, total: ("", line.format(k=k, at=at)), 0)


class SumStep(AbstractStepInverse):
    """Inverse of one model beside constants.

    Attributes:
        model: the sum.
        inner: inverse of the part that is not constant.
        which: its number.
    """

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
        """See the base class."""
        constants = [part.value for k, part in enumerate(self.model.parts) if k != self.which]
        inner_state = _split(state, self.model.parts)[self.which]
        return self.inner.solve(inner_state, u0, target - sum(constants), dt, low, high)


class Series(AbstractComposition):
    """The output of each model is the input of the next: a lag before, creep or a resonance after a hysteresis.

    Raises:
        ModelError: a part is no model.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        _check_parts(parts, 2, "Series")
        self.parts = parts

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """States of the parts, then the signals between them."""
        states, between, signal = [], [], u0
        for part in self.parts:
            states.append(part.init(signal))
            signal = part.sweep(states[-1], signal, signal[None], jnp.zeros((1,)))[1][0]
            between.append(signal)
        return jnp.concatenate([*states, jnp.stack(between[:-1])])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample through the chain."""
        states, between, signal = [], [], u1
        for part, s, old in self._chain(state, u0):
            s, signal = part.step(s, old, signal, dt)
            states.append(s)
            between.append(signal)
        return jnp.concatenate([*states, jnp.stack(between[:-1])]), signal

    def sweep(
        self,
        state: Float[Array, " state"],
        u0: Float[Array, ""],
        u: Float[Array, " T"],
        dt: Float[Array, " T"],
        unroll: int = 1,
    ) -> tuple[Float[Array, " state"], Float[Array, " T"]]:
        """A scan for each part, over all that the part before it puts out."""
        states, between, signal = [], [], u
        for part, s, old in self._chain(state, u0):
            s, signal = part.sweep(s, old, signal, dt, unroll)
            states.append(s)
            between.append(signal[-1])
        return jnp.concatenate([*states, jnp.stack(between[:-1])]), signal

    def _chain(self, state: Array, u0: Array) -> list[tuple[AbstractHysteresis, Array, Array]]:
        """Every part, its state, and the input that it had last."""
        edge = state.shape[0] - len(self.parts) + 1
        return list(zip(self.parts, _split(state[:edge], self.parts), [u0, *state[edge:]], strict=True))

    def start(self, records: Sequence[Record]) -> Series:
        """Starting values of each part come from the output of the part before it and the measured output."""
        started, arriving = [], list(records)
        for k, part in enumerate(self.parts):
            started.append(part.start(arriving))
            if k < len(self.parts) - 1:
                outputs = [np.asarray(simulate(started[-1], r.u, r.dt)[0]) for r in arriving]
                arriving = [r.replace(u=y) for r, y in zip(arriving, outputs, strict=True)]
        return type(self)(*started)

    def _with_rest_sample(self, u: Any, dt: Any) -> tuple[np.ndarray, np.ndarray]:
        """The input with one more sample before the first, so that each part starts from its own rest, as in `init`."""
        u, dt = drive(self, u, dt)
        return np.append(u[0], u), np.append(0.0, dt)

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """Part by part, where some part has a short cut."""
        if not self.has_fast_run:
            return super().free_run(u, dt)
        signal, steps = self._with_rest_sample(u, dt)
        for part in self.parts:
            signal = part.free_run(signal, steps)
        return signal[1:]

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """That of the first part, and of the others where it only filters the input."""
        others = self.parts[1:] if self.parts[0].linear_in_input else ()
        return tuple(line for part in (self.parts[0], *others) for line in part.advice(u, dt))

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
        return next((edges for part in self.parts if (edges := part.reach()) is not None), None)

    def output_resonance(self) -> OutputResonance | None:
        """The resonance of the last part, and the parts before it."""
        last = self.parts[-1].output_resonance()
        if last is None:
            return None
        before = [*self.parts[:-1], *(() if last.model is None else (last.model,))]
        return OutputResonance(before[0] if len(before) == 1 else Series(*before), last.omega, last.zeta)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """Those of the parts, from the last to the first; a search where a part needs limits and has no range."""
        inner = tuple(part.step_inverse() for part in self.parts)
        open_ = (-np.inf, np.inf)
        ranges = [part.reach() if s.needs_limits else open_ for s, part in zip(inner, self.parts, strict=True)]
        if any(edges is None for edges in ranges[1:]):
            return SearchStep(self, sign)
        return SeriesStep(self, inner, jnp.asarray([edges or open_ for edges in ranges]))

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

        return _join_c_parts(self.parts, "Each output is the next one's input.", lines, len(self.parts) - 1)


class SeriesStep(AbstractStepInverse):
    """Inverses of the parts of a `Series`, from the last to the first.

    Attributes:
        model: the series.
        inner: an inverse for each part.
        edges: between which input limits each part but the first is searched, infinite for closed forms.
    """

    model: Series
    inner: tuple[AbstractStepInverse, ...]
    edges: Float[Array, "parts two"]

    @property
    def needs_limits(self) -> bool:
        """As its first part."""
        return self.inner[0].needs_limits

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        """See the base class."""
        count = len(self.inner) - 1
        states = _split(state, self.model.parts)
        before = [u0, *(state[state.shape[0] - count + k] for k in range(count))]
        rising: Array = jnp.asarray(True)
        for k in range(count, 0, -1):
            target, fine = self.inner[k].solve(states[k], before[k], target, dt, *self.edges[k])
            rising = rising & fine
        u1, fine = self.inner[0].solve(states[0], u0, target, dt, low, high)
        return Root(u1, rising & fine)


def _filter_design(part: AbstractHysteresis, design: DesignMatrix, dt: np.ndarray) -> DesignMatrix:
    """A design matrix, one row a sample, through a filter that is linear in its input."""
    columns = [block.columns for block in design.blocks]
    out = np.asarray(_filtered(part, jnp.asarray(np.column_stack([design.rest, *columns])), jnp.asarray(dt)))
    edges = np.cumsum([1, *(block.shape[1] for block in columns)])
    blocks = (
        dataclasses.replace(block, columns=out[:, lo:hi])
        for block, (lo, hi) in zip(design.blocks, itertools.pairwise(edges), strict=True)
    )
    return DesignMatrix(tuple(blocks), out[:, 0], design.index)


@eqx.filter_jit
def _filtered(part: Any, signals: Array, dt: Array) -> Array:
    """Outputs for each column of signals, shape (T, p); of all but the first less the response of the initial state."""
    outputs = jax.vmap(lambda signal: run(part, signal, dt)[0], in_axes=1, out_axes=1)(signals)
    constant = run(part, jnp.zeros_like(dt), dt)[0]
    return outputs.at[:, 1:].add(-constant[:, None])


def _join_c_parts(
    parts: Sequence[AbstractHysteresis], doc: str, lines: Callable[[int, int, int], tuple[str, str]], between: int
) -> CPart:
    """C code of a composition.

    Args:
        parts: models.
        doc: comment.
        lines: for the number of a part, the place of its state and the states of all: lines of `init` after its own, and of `step`.
        between: number of signals that the state holds after the states of the parts.
    """
    codes = tuple(part.c_part() for part in parts)
    places = np.cumsum([0, *(code.states for code in codes)]).tolist()
    init, step = "", ""
    for k, at in enumerate(places[:-1]):
        after, now = lines(k, at, places[-1])
        init += f"    @f@{k}_init(s + {at}, signal);\n{after}"
        step += now
    words = functools.reduce(
        lambda text, word: text.replace(f"@{word[0]}@", word[1]),
        (("doc", doc), ("init", init), ("step", step)),
        template("series.c"),
    )
    return CPart(words, places[-1] + between, parts=codes)


class Offset(AbstractHysteresis):
    """A constant of its own for each record:  y = value."""

    rate_independent: ClassVar[bool] = True

    value: Float[Array, ""] = param(0.0, unit="y", per_record=True, linear=True, doc="constant added to the output")

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """No state."""
        return jnp.zeros((0,), dtype=jnp.result_type(float))

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """The constant."""
        return state, self.value + 0.0 * u1

    def start(self, records: Sequence[Record]) -> Offset:
        """Mean of the output."""
        return type(self)(value=float(np.mean([np.mean(record.y[record.used]) for record in records])))

    def c_part(self) -> CPart:
        """A number."""
        return CPart(template("offset.c"), 0, {"VALUE": self.value})
