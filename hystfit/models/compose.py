"""Models built of models: `Sum` adds outputs, `Series` feeds one into the next."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractFilter, AbstractHysteresis, simulate
from hystfit.params.param import param


def _size(model: AbstractHysteresis) -> int:
    return jax.eval_shape(model.init, jnp.zeros(())).shape[0]


def _split(state: Array, parts: Sequence[AbstractHysteresis]) -> list[Array]:
    edges = np.cumsum([_size(part) for part in parts])
    return [state[end - _size(part) : end] for end, part in zip(edges, parts, strict=True)]


def _check_parts(parts: Sequence[AbstractHysteresis], least: int, name: str) -> None:
    if len(parts) < least or not all(isinstance(part, AbstractHysteresis) for part in parts):
        raise ModelError(f"{name} needs at least {least} models, got {[type(part).__name__ for part in parts]}")


def with_rest(model: AbstractHysteresis, rest: str) -> AbstractHysteresis:
    """The same model whose parts rested before the record on their `level`, or on the record's "first" input."""
    if isinstance(model, (Sum, Series)):
        return type(model)(*(with_rest(part, rest) for part in model.parts))
    if not hasattr(model, "rest"):
        return model
    changed = {field.name: getattr(model, field.name) for field in dataclasses.fields(model)}
    return type(model)(**{**changed, "rest": rest})


def has_rest(model: AbstractHysteresis) -> bool:
    """Whether any part knows an input on which it rested before the record."""
    if isinstance(model, (Sum, Series)):
        return any(has_rest(part) for part in model.parts)
    return hasattr(model, "rest")


def _residual(record: Record, model: AbstractHysteresis) -> Record:
    y, _ = simulate(model, record.u, record.dt)
    return record.replace(y=record.y - np.asarray(y))


class Sum(AbstractHysteresis):
    """Outputs of several models of the same input, added: a hysteresis, its creep, a viscous force.

    Raises:
        ModelError: a part is no model.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        _check_parts(parts, 1, "Sum")
        self.parts = parts

    @property
    def rate_independent(self) -> bool:
        """As the most demanding part."""
        return all(part.rate_independent for part in self.parts)

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """States of the parts, one after another."""
        return jnp.concatenate([part.init(u0) for part in self.parts])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample of every part."""
        steps = [part.step(own, u0, u1, dt) for part, own in zip(self.parts, _split(state, self.parts), strict=True)]
        return jnp.concatenate([own for own, _ in steps]), sum((y for _, y in steps), jnp.zeros_like(u1))

    def sweep(
        self,
        state: Float[Array, " state"],
        u0: Float[Array, ""],
        u: Float[Array, " T"],
        dt: Float[Array, " T"],
        unroll: int = 1,
    ) -> tuple[Float[Array, " state"], Float[Array, " T"]]:
        """A scan for each part: a loop over all at once touches too much to be compiled into one piece."""
        runs = [
            part.sweep(own, u0, u, dt, unroll) for part, own in zip(self.parts, _split(state, self.parts), strict=True)
        ]
        return jnp.concatenate([own for own, _ in runs]), sum((y for _, y in runs), jnp.zeros_like(u))

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """What the parts say."""
        return tuple(line for part in self.parts for line in part.advice(u))

    def start(self, records: Sequence[Record]) -> Sum:
        """Each part starts on what the parts before it leave."""
        started, left = [], list(records)
        for part in self.parts:
            started.append(part.start(left))
            left = [_residual(record, started[-1]) for record in left]
        return type(self)(*started)


class Series(AbstractHysteresis):
    """The output of each model is the input of the next: a lag before, creep or a resonance after a hysteresis.

    Raises:
        ModelError: a part is no model, or all are filters.
    """

    parts: tuple[AbstractHysteresis, ...] = eqx.field(converter=tuple)

    def __init__(self, *parts: AbstractHysteresis):
        _check_parts(parts, 2, "Series")
        self.parts = parts

    @property
    def rate_independent(self) -> bool:
        """As the most demanding part."""
        return all(part.rate_independent for part in self.parts)

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """States of the parts, then the signals between them."""
        states, between, signal = [], [], u0
        for part in self.parts:
            states.append(part.init(signal))
            _, signal = part.step(states[-1], signal, signal, jnp.zeros_like(u0))
            between.append(signal)
        return jnp.concatenate([*states, jnp.stack(between[:-1])])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample through the chain."""
        states, between, signal = [], [], u1
        for part, own, old in self._chain(state, u0):
            own, signal = part.step(own, old, signal, dt)
            states.append(own)
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
        for part, own, old in self._chain(state, u0):
            own, signal = part.sweep(own, old, signal, dt, unroll)
            states.append(own)
            between.append(signal[-1])
        return jnp.concatenate([*states, jnp.stack(between[:-1])]), signal

    def _chain(self, state: Array, u0: Array) -> list[tuple[AbstractHysteresis, Array, Array]]:
        """Every part, its state, and the input that it had last."""
        edge = state.shape[0] - len(self.parts) + 1
        return list(zip(self.parts, _split(state[:edge], self.parts), [u0, *state[edge:]], strict=True))

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """What the parts say of the signal that reaches them, as far as it is the input itself."""
        return self.parts[0].advice(u) + tuple(
            line for part in self.parts[1:] if isinstance(self.parts[0], AbstractFilter) for line in part.advice(u)
        )

    def start(self, records: Sequence[Record]) -> Series:
        """Filters start by themselves; the others on the input that reaches them and the measured output."""
        started, reach = [], list(records)
        for k, part in enumerate(self.parts):
            started.append(part.start(reach))
            if k < len(self.parts) - 1:
                outputs = [np.asarray(simulate(started[-1], r.u, r.dt)[0]) for r in reach]
                reach = [r.replace(u=y) for r, y in zip(reach, outputs, strict=True)]
        return type(self)(*started)


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
