"""Parameters, declared once, on the field of a model; `hystfit.params.space` collects them by name into vectors."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ParameterError
from hystfit.params.host_arrays import to_device
from hystfit.params.units import exponents


@dataclasses.dataclass(frozen=True)
class ParamInfo:
    """Declaration of a parameter on a field."""

    bounds: tuple[float, float] = (-math.inf, math.inf)  # (lower, upper) in physical units
    unit: str = "1"  # expression in u, y and s (see `hystfit.params.units`)
    scale: float = 1.0  # typical size in multiples of the unit's natural size
    doc: str = ""  # meaning, one sentence
    fixed: bool = False  # kept at its value unless freed by name
    per_record: bool = False  # each record of a fit has its own value
    linear: bool = False  # the output of the model is linear in it
    common: bool = False  # one value serves all records of this model, although each record of others has its own
    stepwise: bool = False  # the output is piecewise constant in it, so that derivatives tell nothing about it

    def __post_init__(self) -> None:
        exponents(self.unit)
        lower, upper = self.bounds
        if not lower < upper:
            raise ParameterError(f"bounds must be (lower, upper) with lower < upper, got {self.bounds}")
        if not (self.scale > 0 and math.isfinite(self.scale)):
            raise ParameterError(f"scale must be positive and finite, got {self.scale}")


def as_array(value: Any) -> Any:
    """A number or array as a floating array; other leaves of a tree (tracers, placeholders) unchanged."""
    # Python numbers in a module are static for jit: one compilation for each value, and no gradient (nor for integer arrays).
    if type(value) is float:
        return _number(value, math.copysign(1.0, value), _float_type())
    whole = isinstance(value, jax.Array) and not jnp.issubdtype(value.dtype, jnp.floating)
    traced = isinstance(value, (list, tuple)) and any(
        isinstance(element, jax.core.Tracer) for element in jax.tree_util.tree_leaves(value)
    )
    try:
        if whole or traced:
            if jnp.iscomplexobj(value):
                raise TypeError("complex")
            return jnp.asarray(value, dtype=_float_type())
        if isinstance(value, (int, float, complex, str, list, tuple, np.ndarray, np.generic)):
            array = np.asarray(value)
            if array.dtype.kind not in "biuf":
                raise TypeError("no real number")
            return to_device(array, _float_type())
    except (TypeError, ValueError) as error:
        raise ParameterError(f"a parameter must be a real number or an array of them, got {value!r}") from error
    return value


def _float_type() -> Any:
    return np.float64 if jax.config.jax_enable_x64 else np.float32  # type: ignore[attr-defined]


@functools.lru_cache(maxsize=1024)
def _number(value: float, sign: float, dtype: Any) -> jax.Array:
    """A number as an array, made once and shared: arrays are immutable, and making them would dominate the time to build a model.

    `sign` tells 0.0 from -0.0, which are equal as keys.
    """
    with jax.ensure_compile_time_eval():
        return to_device(value, dtype)


def _as_vector(value: Any) -> Any:
    array = as_array(value)
    return jnp.atleast_1d(array) if isinstance(array, jax.Array) and not array.ndim else array


def param(
    default: Any = dataclasses.MISSING,
    *,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    unit: str = "1",
    scale: float = 1.0,
    doc: str = "",
    fixed: bool = False,
    per_record: bool = False,
    linear: bool = False,
    common: Callable[[Any], bool] | None = None,
    effect: Callable[[Any], Any] | None = None,
    vector: bool = False,
    stepwise: bool = False,
    declared: Callable[[Any], tuple[str, ParamInfo]] | None = None,
) -> Any:
    """A field of a model that is a parameter.

    Args:
        default: value, a number or an array.
        bounds, unit, scale, doc, fixed, per_record, linear, stepwise: see `ParamInfo`.
        common: whether one value serves all records of a given model, where `per_record`.
        effect: of a given model, the largest output of each element for a value of one, of the shape of the parameter (or one that
            broadcasts to it): 0.01 for a weighted stop that yields at a hundredth of the range. It widens the default prior; 1 by default.
        vector: the parameter is an array of one dimension; a number becomes an array of one element.
        declared: of a given part of a model, the name and declaration of the parameter, where they are not those of the field.

    Raises:
        ParameterError: bounds in the wrong order, a scale that is not positive, a unit that is not an expression.
    """
    info = ParamInfo(bounds, unit, scale, doc, fixed, per_record, linear, stepwise=stepwise)
    extra = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(
        converter=_as_vector if vector else as_array,
        metadata={"param": info, "common": common, "effect": effect, "declared": declared},
        **extra,
    )


def element_weights(default: Any = dataclasses.MISSING, **declared: Any) -> Any:
    """A field of weights of elements that add up, such as plays: an array of numbers >= 0 in which the output is linear."""
    usual = {"bounds": (0.0, math.inf), "unit": "y", "scale": 0.1, "linear": True, "vector": True}
    return param(default, **{**usual, **declared})


def element_places(default: Any = dataclasses.MISSING, **declared: Any) -> Any:
    """A field that places elements and is not fitted, such as thresholds or time constants: an array of positive numbers."""
    return param(default, **{"bounds": (0.0, math.inf), "fixed": True, "vector": True, **declared})


@dataclasses.dataclass(frozen=True)
class Leaf:
    """One array-valued parameter of a tree: its position, path, declaration and shape, and what gives its `effect`."""

    index: int
    path: tuple[str, ...]
    info: ParamInfo
    shape: tuple[int, ...]
    effect: Callable[[], Any] | None = None

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    def effects(self) -> np.ndarray:
        """The `effect` of each element, flat; 1 where none is declared."""
        declared = 1.0 if self.effect is None else np.asarray(self.effect(), dtype=float)
        return np.broadcast_to(declared, self.shape).reshape(-1)

    def element(self, k: int) -> str:
        """Suffix of one element: "" for a number, "[2]" or "[2,0]" in an array."""
        return "" if not self.shape else "[" + ",".join(str(i) for i in np.unravel_index(k, self.shape)) + "]"


def _declaration(node: Any, field: dataclasses.Field[Any]) -> tuple[str, ParamInfo | None]:
    """Name of a field of a model, and what it declares; None for one that is no parameter."""
    if declared := field.metadata.get("declared"):
        return declared(node)
    info, common = field.metadata.get("param"), field.metadata.get("common")
    if info is not None and common and common(node):
        info = dataclasses.replace(info, per_record=False, common=True)
    return field.name, info


def _steps(tree: Any, path: tuple[Any, ...]) -> tuple[tuple[str, ...], ParamInfo | None, Callable[[], Any] | None]:
    """Readable path of a leaf, and its `ParamInfo` and `effect` if its last field declares them."""
    node, words, info, effect = tree, [], None, None
    for key in path:
        info, effect = None, None
        if isinstance(key, jax.tree_util.GetAttrKey):
            word = key.name
            fields = dataclasses.fields(node) if dataclasses.is_dataclass(node) else ()  # a named tuple has none
            if field := next((f for f in fields if f.name == key.name), None):
                word, info = _declaration(node, field)
                declared = field.metadata.get("effect")
                effect = functools.partial(declared, node) if declared else None
            words.append(word)
            node = getattr(node, key.name)
        elif isinstance(key, jax.tree_util.SequenceKey):
            snake = lambda name: re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
            siblings = [snake(type(child).__name__) for child in node]
            word = siblings[key.idx]
            words.append(f"{word}{siblings[: key.idx].count(word) + 1}" if siblings.count(word) > 1 else word)
            node = node[key.idx]
        elif isinstance(key, jax.tree_util.DictKey):
            words.append(str(key.key))
            node = node[key.key]
        else:
            words.append(str(key))
            return tuple(words), None, None
    return tuple(words), info, effect


def leaves_of(tree: Any) -> list[Leaf]:
    """All parameters of a tree, in the order of its leaves."""
    found = []
    for index, (path, value) in enumerate(jax.tree_util.tree_flatten_with_path(tree)[0]):
        words, info, effect = _steps(tree, path)
        if info is not None:
            found.append(Leaf(index, words, info, tuple(np.shape(value)), effect))
    return found


def short_names(paths: Sequence[tuple[str, ...]]) -> list[str]:
    """The shortest unique ends of the paths."""
    names = []
    for path in paths:
        for length in range(1, len(path) + 1):
            tail = path[-length:]
            if sum(other[-length:] == tail for other in paths) == 1:
                break
        names.append(".".join(tail))
    return names
