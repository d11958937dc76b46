"""Models as JSON: every number in full, readable, and the same model back."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.registry import class_from_file


def to_json(model: AbstractHysteresis) -> dict[str, Any]:
    """A JSON-able description: class, and fields by name.

    Raises:
        ModelError: a field holds something that has no description.
    """
    return _pack(model)


def from_json(described: dict[str, Any]) -> AbstractHysteresis:
    """The model that `to_json` described.

    Raises:
        ModelError: not such a description, or its class is gone.
    """
    model = _unpack(described)
    if not isinstance(model, AbstractHysteresis):
        raise ModelError("the file describes no hystfit model")
    return model


def _pack(value: Any) -> Any:
    if isinstance(value, eqx.Module):
        kind = type(value)
        home = kind.__module__ if kind.__module__.startswith("hystfit.") else inspect.getfile(kind)
        fields = {field.name: _pack(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"class": f"{home}:{kind.__name__}", "fields": fields}
    if isinstance(value, (jax.Array, np.ndarray)):
        array = np.asarray(value)
        return {"array": array.tolist(), "shape": list(array.shape)}
    if isinstance(value, tuple):
        return {"tuple": [_pack(item) for item in value]}
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    raise ModelError(f"cannot save a field of type {type(value).__name__}")


def _unpack(described: Any) -> Any:
    try:
        if "class" in described:
            home, _, name = described["class"].rpartition(":")
            if home.endswith(".py"):
                kind = class_from_file(home, name, eqx.Module, ModelError)
            else:
                kind = getattr(importlib.import_module(home), name)
            # A frozen module is rebuilt field by field: constructors such as Sum(*parts) do not take their fields.
            model = object.__new__(kind)
            for field, value in described["fields"].items():
                object.__setattr__(model, field, _unpack(value))
            return model
        if "array" in described:
            return jnp.asarray(np.array(described["array"], dtype=float).reshape(described["shape"]))
        if "tuple" in described:
            return tuple(_unpack(item) for item in described["tuple"])
        return described["value"]
    except (KeyError, TypeError, AttributeError, ImportError, ValueError) as error:
        raise ModelError(f"not a model as hystfit saves it: {type(error).__name__}: {error}") from error
