"""Models as JSON: every number in full, readable, and the same model back.

A description names classes. Those of hystfit are found in its own rooms of models; a class of the user's is used where this process
has it already, and its file is run only where the caller allows that file.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.registry import class_from_file, file_of, in_process

_ROOM = "hystfit.models"
_SESSION = "session"  # home of a class that was typed into an interpreter


def to_json(model: AbstractHysteresis) -> dict[str, Any]:
    """A JSON-able description: class, and fields by name; a ModelError where a field holds something that has none."""
    return _pack(model)


def from_json(described: dict[str, Any], allowed: Collection[str] = ()) -> AbstractHysteresis:
    """The model that `to_json` described; `allowed` are the files of the user's that may be run."""
    model = _unpack(described, allowed)
    if not isinstance(model, AbstractHysteresis):
        raise ModelError("the file describes no hystfit model")
    return model


def user_classes(model: Any) -> Iterator[type]:
    """Classes within a model that are not hystfit's own."""
    if isinstance(model, eqx.Module):
        if not _is_own(type(model).__module__):
            yield type(model)
        for field in dataclasses.fields(model):
            yield from user_classes(getattr(model, field.name))
    elif isinstance(model, tuple):
        for item in model:
            yield from user_classes(item)


def files_named(described: Any) -> set[str]:
    """Files of the user's that a description names."""
    if isinstance(described, list):
        return set().union(*map(files_named, described))
    if not isinstance(described, dict):
        return set()
    found = set().union(*map(files_named, described.values()))
    home = str(described.get("class", "")).rpartition(":")[0]
    return found | {home} if home.endswith(".py") else found


def _is_own(module: str) -> bool:
    return module == _ROOM or module.startswith(f"{_ROOM}.")


def _home(kind: type) -> str:
    """Where a class is found again."""
    if _is_own(kind.__module__):
        return kind.__module__
    file = file_of(kind)
    return str(Path(file).resolve()) if file.endswith(".py") and Path(file).is_file() else _SESSION


def _pack(value: Any) -> Any:
    if isinstance(value, eqx.Module):
        kind = type(value)
        fields = {field.name: _pack(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"class": f"{_home(kind)}:{kind.__name__}", "fields": fields}
    if isinstance(value, (jax.Array, np.ndarray)):
        array = np.asarray(value)
        return {"array": array.tolist(), "shape": list(array.shape)}
    if isinstance(value, tuple):
        return {"tuple": [_pack(item) for item in value]}
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    raise ModelError(f"cannot save a field of type {type(value).__name__}")


def _unpack(described: Any, allowed: Collection[str]) -> Any:
    try:
        if "class" in described:
            kind = _class_of(described["class"], allowed)
            fields = described["fields"]
            names = [field.name for field in dataclasses.fields(kind)]
            if set(fields) != set(names):
                raise ModelError(
                    f"{kind.__name__} has the fields {', '.join(names)}, the description {', '.join(fields)}"
                )
            # A frozen module is rebuilt field by field: constructors such as Sum(*parts) do not take their fields.
            model = object.__new__(kind)
            for field in names:
                object.__setattr__(model, field, _unpack(fields[field], allowed))
            for base in kind.__mro__:  # what its constructor would have checked
                if "__check_init__" in vars(base):
                    vars(base)["__check_init__"](model)
            return model
        if "array" in described:
            return _array(described["array"], described["shape"])
        if "tuple" in described:
            return tuple(_unpack(item, allowed) for item in described["tuple"])
        value = described["value"]
        if not (value is None or isinstance(value, (bool, int, float, str))):
            raise TypeError(f"a value of type {type(value).__name__}")
        return value
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, RecursionError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"not a model as hystfit saves it: {type(error).__name__}: {error}") from error


def _array(values: Any, shape: Any) -> jax.Array:
    array = np.array(values)
    if array.size and (array.dtype.kind not in "fiu" or not np.isfinite(array).all()):
        raise TypeError(f"an array of {array.dtype} instead of finite numbers")
    if not all(type(n) is int and n >= 0 for n in shape):
        raise TypeError(f"shape {shape!r}")
    return jnp.asarray(array.astype(float).reshape(shape))


def _class_of(place: Any, allowed: Collection[str]) -> type[eqx.Module]:
    """The class of a description, without running anything but hystfit's own modules and allowed files."""
    home, _, name = str(place).rpartition(":")
    if _is_own(home):
        try:
            kind = getattr(importlib.import_module(home), name, None)
        except ImportError:
            kind = None
    elif home == _SESSION:
        kind = getattr(sys.modules["__main__"], name, None)
        if kind is None:
            raise ModelError(f"the class {name} was typed into an interpreter: define it again, then open the fit")
    elif home in allowed or (home.endswith(".py") and in_process(Path(home))):
        kind = class_from_file(home, name, eqx.Module, ModelError)
    else:
        raise ModelError(f"{place!r} is not a model of hystfit's")
    if not (isinstance(kind, type) and issubclass(kind, eqx.Module)) or (_is_own(home) and kind.__module__ != home):
        raise ModelError(f"{place!r} is not a model")
    if getattr(kind, "__abstractmethods__", None):
        raise ModelError(f"{place!r} is an unfinished class")
    return kind
