"""A model's part of the exported C code (see `hystfit.control.export`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

_FOLDER = files("hystfit.models") / "c"


@dataclasses.dataclass(frozen=True)
class CPart:
    """What the C code of a model is made of.

    The template defines two functions, in which @f@ stands for a prefix and @M@ for the prefix in capitals:

        static void @f@_init(double *s, double u0)
        static double @f@_step(const double *s, double u0, double u1, double dt, double *next)

    `init` sets the state in equilibrium at the input u0; `step` returns the output at u1, dt after u0, and writes the new state to `next`
    unless that is 0; `next` may be `s`. `legendre(c, n, x)`, a Legendre series, is at hand.

    Attributes:
        template: C99 text.
        states: number of doubles of state.
        numbers: macros @M@_NAME by NAME; a text is written as it is.
        arrays: static arrays @f@_name by name, of doubles or of whole numbers.
        parts: of a composition, whose prefixes are @f@0, @f@1, ...
    """

    template: str
    states: int
    numbers: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    arrays: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    parts: tuple[CPart, ...] = ()


def template(name: str) -> str:
    """Text of a template of this package."""
    return (_FOLDER / name).read_text(encoding="utf-8")
