"""What compositions of models have in common."""

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
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart, template
from hystfit.models.shared.design import Block
from hystfit.models.shared.reported import Derived, PlayWeights


def split_state(state: Array, parts: Sequence[AbstractHysteresis]) -> list[Array]:
    """States of the parts of a composition, which come first in its state, one after another."""
    sizes = [jax.eval_shape(part.init, jnp.zeros(())).shape[0] for part in parts]
    edges = np.cumsum([0, *sizes])
    return [state[lo:hi] for lo, hi in itertools.pairwise(edges)]


def check_parts(parts: Sequence[AbstractHysteresis], least: int, name: str) -> None:
    """Refuse parts that are not models, or too few of them."""
    if len(parts) < least or not all(isinstance(part, AbstractHysteresis) for part in parts):
        raise ModelError(f"{name} needs at least {least} models, got {[type(part).__name__ for part in parts]}")


def _of_all(name: str) -> property:
    return property(
        lambda self: all(getattr(part, name) for part in self.parts), doc="Whether it is true of all parts."
    )


def _of_any(name: str) -> property:
    return property(
        lambda self: any(getattr(part, name) for part in self.parts), doc="Whether it is true of some part."
    )


class AbstractComposition(AbstractHysteresis):
    """Methods that `Sum` and `Series` delegate to their parts in the same way."""

    parts: eqx.AbstractVar[tuple[AbstractHysteresis, ...]]

    one_scan: ClassVar[bool] = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(repr(part) for part in self.parts)})"

    takes_rate = _of_any("takes_rate")
    rate_independent = _of_all("rate_independent")
    hysteretic = _of_any("hysteretic")
    allows_thinning = _of_all("allows_thinning")
    linear_in_input = _of_all("linear_in_input")
    causal = _of_all("causal")
    has_fast_run = _of_any("has_fast_run")
    delays = _of_any("delays")
    creeps = _of_any("creeps")
    hardens = _of_any("hardens")
    degrades = _of_any("degrades")
    has_inverse = _of_all("has_inverse")
    either_way = _of_any("either_way")
    has_rest = _of_any("has_rest")
    jumps = _of_any("jumps")
    searches = _of_any("searches")
    from_saturation = _of_any("from_saturation")

    def prepared(self, record: Record) -> Record:
        """As all parts need it: those that take the rate see its first sample before another one puts a period before it."""
        parts = sorted(self.parts, key=lambda part: not part.takes_rate)
        return functools.reduce(lambda prepared, part: part.prepared(prepared), parts, record)

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

    def with_rest(self, rest: str) -> AbstractHysteresis:
        return type(self)(*(part.with_rest(rest) for part in self.parts))

    def without_creep(self) -> AbstractHysteresis | None:
        still = [part.without_creep() for part in self.parts]
        if all(part is None for part in still):
            return None
        return type(self)(*(part if other is None else other for part, other in zip(self.parts, still, strict=True)))

    def choices(self, records: Sequence[Record]) -> tuple[tuple[AbstractHysteresis, ...], ...]:
        """Those of the first part that has a choice, on the records as they are: no part changes the number of samples or levels."""
        for k, part in enumerate(self.parts):
            if groups := part.choices(records):
                around = lambda other, k=k: type(self)(*self.parts[:k], other, *self.parts[k + 1 :])
                return tuple(tuple(map(around, group)) for group in groups)
        return ()

    def _blocks(self, number: int, blocks: Sequence[Block]) -> list[Block]:
        """Blocks of one part, numbered among the leaves of the composition."""
        before = sum(len(jax.tree_util.tree_leaves(part)) for part in self.parts[:number])
        return [dataclasses.replace(block, leaf=block.leaf + before) for block in blocks]


def join_c_parts(
    parts: Sequence[AbstractHysteresis], doc: str, lines: Callable[[int, int, int], tuple[str, str]], between: int
) -> CPart:
    """C code of a composition.

    Args:
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
