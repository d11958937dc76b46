"""A model's part of the exported C code (see `hystfit.control.export`)."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

_FOLDER = files("hystfit.models") / "c"


@dataclasses.dataclass(frozen=True)
class CPart:
    """What the C code of a model is made of.

    The template defines two functions, in which @f@ stands for a prefix and @M@ for the prefix in capitals:

        static void @f@_init(double *s, double u0)
        static double @f@_step(const double *s, double u0, double u1, double dt, double *next)

    `init` sets the state in equilibrium at the input u0; `step` returns the output at u1, dt after u0, and writes the new state to `next`
    unless that is 0; `next` may be `s`. `legendre(c, n, x)`, a Legendre series, is at hand.
    """

    template: str  # C99 text
    states: int  # number of doubles of state
    # macros @M@_NAME by NAME; a text is written as it is
    numbers: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # static arrays @f@_name by name, of doubles or of whole numbers
    arrays: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    parts: tuple[CPart, ...] = ()  # of a composition, whose prefixes are @f@0, @f@1, ...

    @classmethod
    def of(cls, model: Any, name: str, states: int | None = None, **values: Any) -> CPart:
        """The part of a model whose template names its fields: @M@_TAU is the number `tau`, @f@_w the array `w`, @M@_W_SIZE its length.

        `name` is that of the template's file, without ".c". Values that are no fields, or stand for some, are written if the template names
        them.
        """
        text = template(f"{name}.c")
        fields = {field.name: getattr(model, field.name) for field in dataclasses.fields(model)} | values
        plain = {key: value for key, value in fields.items() if not isinstance(value, str)}
        arrays = {key: value for key, value in plain.items() if np.ndim(value)}
        numbers = {key.upper(): value for key, value in plain.items() if not np.ndim(value)}
        numbers |= {f"{key.upper()}_SIZE": int(np.size(value)) for key, value in arrays.items()}
        used = set(re.findall(r"@[fM]@_\w+", text))
        return cls(
            text,
            jax.eval_shape(model.init, jnp.zeros(())).shape[0] if states is None else states,
            {key: value for key, value in numbers.items() if f"@M@_{key}" in used},
            {key: value for key, value in arrays.items() if f"@f@_{key}" in used and np.size(value)},
        )


def template(name: str) -> str:
    """Text of a template of this package."""
    return (_FOLDER / name).read_text(encoding="utf-8")
