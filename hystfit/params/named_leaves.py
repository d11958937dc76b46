"""The parameters of a tree by name: arrays, their elements, and their values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ParameterError
from hystfit.params.host_arrays import to_device
from hystfit.params.param import leaves_of, short_names
from hystfit.registry import near


def _strong(leaf: Any) -> Any:
    # Python numbers have a weak type, and every mixture of weak and strong types would be compiled separately; arrays made before
    # double precision was switched on are single.
    if not isinstance(leaf, jax.Array) or isinstance(leaf, jax.core.Tracer):
        return leaf
    kind = jnp.result_type(float) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf.dtype
    return to_device(leaf, kind) if leaf.weak_type or leaf.dtype != kind else leaf


class NamedLeaves:
    """The arrays of parameters of a tree (a model, or (model, noise)), with the shortest names that tell them apart."""

    def __init__(self, tree: Any):
        self.leaves = leaves_of(tree)
        if not self.leaves:
            raise ParameterError(f"{type(tree).__name__} has no parameters: declare fields with hystfit.param()")
        self.names = short_names([leaf.path for leaf in self.leaves])

    def find(self, name: str) -> tuple[int, list[int]]:
        """Leaf number and flat positions of a name: a leaf ("w"), one element ("w[2]"), or a longer path."""
        match = re.fullmatch(r"(?P<path>[^\[\]]+)(?:\[(?P<at>[\d, ]+)\])?", name.strip())
        words = tuple(match["path"].split(".")) if match else ()
        hits = [i for i, leaf in enumerate(self.leaves) if leaf.path[-len(words) :] == words] if words else []
        if match is None or not hits:
            known = ", ".join(self.names)
            raise ParameterError(f"no parameter {name!r}{near(name, self.names)}; the parameters are: {known}")
        if len(hits) > 1:
            hits = [i for i in hits if self.names[i] == match["path"]] or hits
        if len(hits) > 1:
            choices = ", ".join(self.names[i] for i in hits)
            raise ParameterError(f"parameter {name!r} is ambiguous; choose one of: {choices}")
        number, leaf = hits[0], self.leaves[hits[0]]
        if match["at"] is None:
            return number, list(range(leaf.size))
        at = tuple(int(k) for k in match["at"].split(","))
        if len(at) != len(leaf.shape) or any(k >= n for k, n in zip(at, leaf.shape, strict=False)):
            raise ParameterError(f"parameter {name!r}: {self.names[number]} has shape {leaf.shape}")
        return number, [int(np.ravel_multi_index(at, leaf.shape))]

    def element(self, number: int, k: int) -> str:
        """Name of one element of a leaf."""
        return f"{self.names[number]}{self.leaves[number].element(k)}"

    def place(self, number: int, k: int) -> tuple[int, int]:
        """Index of the leaf among all leaves of the tree, and flat position, of one element."""
        return self.leaves[number].index, k

    def with_values(self, tree: Any, values: Mapping[str, Any]) -> Any:
        """A tree of this structure with other values of some parameters, and every array of one type."""
        flat, treedef = jax.tree_util.tree_flatten(tree)
        for name, value in values.items():
            number, positions = self.find(name)
            leaf = self.leaves[number]
            array = np.array(flat[leaf.index], dtype=float)
            if isinstance(value, str):
                raise ParameterError(
                    f"fix= holds {name!r} at a number, got {value!r}: tie={{{name!r}: {value!r}}} ties it to another parameter"
                )
            try:
                array.reshape(-1)[positions] = np.asarray(value, dtype=float).reshape(-1)
            except ValueError as error:
                raise ParameterError(f"parameter {name!r} has {len(positions)} elements, got {value!r}") from error
            if not np.isfinite(array).all():
                raise ParameterError(f"parameter {name!r} must be finite, got {value!r}")
            flat[leaf.index] = to_device(array, jnp.result_type(float))
        return jax.tree_util.tree_unflatten(treedef, [_strong(leaf) for leaf in flat])

    def check_bounds(self, tree: Any) -> None:
        """Refuse values outside the bounds of their parameters."""
        flat = jax.tree_util.tree_leaves(tree)
        for leaf, name in zip(self.leaves, self.names, strict=True):
            value = np.asarray(flat[leaf.index])
            lower, upper = leaf.info.bounds
            if not ((value >= lower) & (value <= upper)).all():  # also refuses NaN
                raise ParameterError(f"parameter {name!r}: {value} is outside its bounds [{lower:g}, {upper:g}]")
