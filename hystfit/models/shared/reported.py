"""What a model reports: its parameters in one line, quantities that follow from them, and weights of its plays."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array


class Derived(NamedTuple):
    """A quantity that follows from the parameters of a model: name, unit expression in u, y and s, meaning, function of the model."""

    name: str
    unit: str
    doc: str
    value: Callable[[Any], Array]


class PlayWeights(NamedTuple):
    """Weights [y] of the plays or stops of one envelope by their half width [u], rising, and the names of these parameters."""

    label: str
    threshold: np.ndarray
    weight: np.ndarray
    names: tuple[str, ...]


def format_model(model: Any) -> str:
    """`BoucWen(c=0.15 y/u, mu=0.5, ...)`: parameters in the units of input u, output y and time s, and changed settings."""
    fields = ((field, getattr(model, field.name, None)) for field in dataclasses.fields(model))
    words = [text for field, value in fields if (text := _field(field, value))]
    return f"{type(model).__name__}({', '.join(words)})"


def _field(field: dataclasses.Field, value: Any) -> str:
    info = field.metadata.get("param")
    if info is not None:
        shown = _values(value)
        unit = "" if info.unit == "1" else f" {info.unit}"
        return f"{field.name}={shown}{unit}" if shown else ""
    plain = isinstance(value, str | bool | int | float)
    return f"{field.name}={value!r}" if plain and value != field.default else ""


def _values(value: Any) -> str:
    """A parameter as text; "" for an array without elements, its type where it has no value (inside traced code)."""
    if isinstance(value, jax.core.Tracer) or not isinstance(value, jax.Array | np.ndarray):
        return eqx.tree_pformat(value)
    array = np.asarray(value)
    if array.size > 4:
        return f"{array.size} values from {array.min():.4g} to {array.max():.4g}"
    if array.ndim == 0:
        return f"{array:.6g}"
    return f"[{', '.join(f'{element:.6g}' for element in array.ravel())}]" if array.size else ""
