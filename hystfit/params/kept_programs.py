"""Traced and lowered programs, kept on disk between processes: half the time of a first fit whose programs are compiled.

JAX keeps compiled programs, but finds one only after it has traced and lowered it again. Here a program is kept as `jax.export`
serializes it: StableHLO, which computes and can do nothing else. Its key is made of the source of hystfit, the versions and settings
on which tracing depends, and the arguments: arrays by shape, everything else by value. Arguments that no text describes by value, such
as a user's class, are traced in every process.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import os
import sys
import tempfile
import threading
import types
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from hystfit.config import PROGRAM_FOLDER, compiles_quickly, platform, program_options
from hystfit.params.program_limit import keep_below_limit
from hystfit.version import version_of

_MOST_BYTES = 2**26  # in the folder; programs unused for longest are removed first
# Numbers in an array of the arguments up to which a program may be compiled without optimization: each linearization of so many samples
# takes 4 ms more (Bouc-Wen with creep), a comparison makes about a hundred with each program, and compiling one takes 0.5 to 1.7 s less.
_FEW_NUMBERS = 2**12
_CHECK = hashlib.sha256().digest_size
_VERSIONED = ("hystfit", "equinox", "jax", "numpy", "builtins")  # packages whose classes a name and a version describe
ARRAYS = (jax.Array, np.ndarray, np.generic)
_BY_VALUE = (bool, int, float, complex, str, bytes, type(None), type(...))


class _NotByValueError(Exception):
    """What is traced depends on more than its text."""


def kept(function: Callable[..., Any], otherwise: Callable[..., Any]) -> Callable[..., Any]:
    """A function that runs the program kept for its arguments, or `otherwise`, by JAX, where no folder for programs is set.

    It is a function of a module of hystfit, of trees, and returns arrays in tuples, lists and dictionaries.
    """
    programs: dict[Any, Callable[..., Any] | None] = {}
    making = threading.RLock()

    def call(*trees: Any) -> Any:
        leaves, structure = jax.tree_util.tree_flatten(trees)
        arrays, fixed = [], []
        kinds = []  # of every leaf its shape and dtype, or None for one that stays in the program
        for leaf in leaves:
            if isinstance(leaf, jax.core.Tracer):
                return otherwise(*trees)
            if isinstance(leaf, ARRAYS):
                arrays.append(leaf)
                kinds.append((leaf.shape, leaf.dtype))
            else:
                fixed.append(leaf)
                kinds.append(None)
        quick = unoptimized(arrays)
        key = (tuple(kinds), structure, tuple((type(leaf), leaf) for leaf in fixed))
        if (key, quick) not in programs:
            traced = tuple(kind is not None for kind in kinds)

            def flat(*arrays: Any) -> Any:
                mixed = iter(arrays), iter(fixed)
                return function(*structure.unflatten([next(mixed[not is_array]) for is_array in traced]))

            dtypes = [jax.dtypes.canonicalize_dtype(array.dtype, allow_extended_dtype=True) for array in arrays]
            exact = [jax.ShapeDtypeStruct(array.shape, dtype) for array, dtype in zip(arrays, dtypes, strict=True)]
            # The dtype of a random key has no value.
            shapes = tuple((array.shape, str(array.dtype)) for array in arrays)
            with making:  # chains in threads ask for the same program
                if (key, quick) not in programs:
                    programs[key, quick] = _program(flat, (_name(function), traced, shapes, *key[1:]), exact, quick)
        program = programs[key, quick]
        return otherwise(*trees) if program is None else program(*arrays)

    @functools.wraps(function)
    def run(*trees: Any) -> Any:
        keep_below_limit()
        return (call if PROGRAM_FOLDER in os.environ else otherwise)(*trees)

    return run


def unoptimized(leaves: Iterable[Any]) -> bool:
    """Whether a program of these arguments is compiled without optimization: on few numbers, where few runs are expected."""
    return compiles_quickly() and all(
        not isinstance(leaf, ARRAYS) or (leaf.size <= _FEW_NUMBERS and not isinstance(leaf, jax.core.Tracer))
        for leaf in leaves
    )


def _program(
    flat: Callable[..., Any], key: tuple[Any, ...], shapes: list[jax.ShapeDtypeStruct], quick: bool
) -> Callable[..., Any] | None:
    """A compiled function of arrays, from the folder or exported into it; None where it cannot be kept."""
    try:
        from jax import export

        name = hashlib.sha256("\n".join((_setting(), _text(key))).encode()).hexdigest()
        path = Path(os.environ[PROGRAM_FOLDER]) / name
        exported = None
        if (content := _read(path)) is not None:
            with suppress(Exception):  # written in an incompatible form, though the versions agree
                exported = export.deserialize(bytearray(content))
        if exported is None:
            exported = export.export(jax.jit(flat), platforms=["cpu"] if platform() == "cpu" else None)(*shapes)
            _write(path, bytes(exported.serialize()))
        return jax.jit(exported.call, compiler_options=program_options(quick))
    except Exception:  # it cannot be exported, described or written; `otherwise` raises an error of the function itself
        return None


# -- what a program depends on ---------------------------------------------------------------------------------------------------


@functools.cache
def _setting() -> str:
    package = Path(sys.modules["hystfit"].__path__[0])
    source = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source.update(str(path.relative_to(package)).encode() + b"\0" + path.read_bytes())
    blackjax = version_of("blackjax") if find_spec("blackjax") else None
    versions = (jax.__version__, version_of("jaxlib"), eqx.__version__, np.__version__, blackjax, sys.version)
    variables = sorted(f"{name}={value}" for name, value in os.environ.items() if name.startswith(("JAX_", "XLA_")))
    return repr((source.hexdigest(), versions, platform(), jax.config.jax_enable_x64, variables))  # type: ignore[attr-defined]


def _text(value: Any) -> str:
    """A text that is equal for two values exactly when they are traced alike."""
    if type(value) in _BY_VALUE or isinstance(value, np.dtype):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, jax.tree_util.PyTreeDef):
        return f"tree {_text(value.node_data())} [{' '.join(map(_text, value.children()))}]"
    if isinstance(value, (type, types.FunctionType)):
        return _name(value)
    if isinstance(value, enum.Enum):
        return f"{_name(type(value))} {value.name}"
    if isinstance(value, (tuple, list)):
        parts = list(value)
    elif isinstance(value, dict):
        parts = list(value.items())
    elif dataclasses.is_dataclass(value):
        parts = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    elif getattr(value, "__dict__", None) == {}:
        parts = []
    else:
        raise _NotByValueError(type(value))
    return f"{_name(type(value))} [{' '.join(map(_text, parts))}]"


def _name(thing: Any) -> str:
    """Where a class or function is found; its package's version determines what it does."""
    module, name = thing.__module__, thing.__qualname__
    if module.partition(".")[0] not in _VERSIONED:
        raise _NotByValueError(thing)
    if module != "builtins":
        place = sys.modules[module]
        for part in name.split("."):
            place = getattr(place, part, None)
        if getattr(place, "__wrapped__", place) is not thing and place is not thing:
            raise _NotByValueError(thing)
    return f"{module}.{name}"


# -- the folder ------------------------------------------------------------------------------------------------------------------


def _read(path: Path) -> bytes | None:
    """The content of a file that is whole, else None."""
    try:
        check, content = (text := path.read_bytes())[:_CHECK], text[_CHECK:]
        if hashlib.sha256(content).digest() != check:
            return None
        os.utime(path)
    except OSError:
        return None
    return content


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically, and remove the files unused for longest where the folder is full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(hashlib.sha256(content).digest() + content)
    os.replace(file.name, path)
    used = sorted(
        ((entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in os.scandir(path.parent)), reverse=True
    )
    total = 0
    for _, size, name in used:
        total += size
        if total > _MOST_BYTES:
            with suppress(OSError):
                os.unlink(name)
