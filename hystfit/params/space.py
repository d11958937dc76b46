"""Free parameters of a tree, by name and as vectors.

`x` is the vector of free parameters in physical units, `z` the same in unconstrained, dimensionless coordinates (see
`hystfit.params.coordinates`).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ParameterError
from hystfit.params.coordinates import BOTH, LOWER, REAL, UPPER, Coordinates
from hystfit.params.host_arrays import to_device
from hystfit.params.named_leaves import NamedLeaves
from hystfit.params.param import ParamInfo, leaves_of
from hystfit.params.ties import Tie, narrowed, ties_of
from hystfit.params.units import Scales

MANY = (
    12  # elements above which an array has one row in a table, and its elements count as weights even with either sign
)
# Linear elements per other free element from which design matrices, with differences for the others, replace forward derivatives, and
# weights are sampled exactly.
_WEIGHTS = 4
_INSIDE = 1e-3  # distance of a start from its bound, see `Coordinates.unconstrained`


def _constants(trees: Sequence[Any]) -> dict[int, np.ndarray]:
    """Leaves that are not parameters and differ between the trees, stacked, by leaf index."""
    if all(tree is trees[0] for tree in trees):
        return {}
    held = {leaf.index for leaf in leaves_of(trees[0])}
    rows = enumerate(zip(*map(jax.tree_util.tree_leaves, trees), strict=True))
    return {k: np.stack(values) for k, values in rows if k not in held and any(v is not values[0] for v in values)}


class ParameterSpace:
    """Free parameters of a tree (a model, or (model, noise)) by name, with their maps between x and z.

    Attributes:
        template: the tree with the values of the fixed parameters.
        named: its arrays by name, `leaves` in their order.
        names: of the free elements, in the order of x and z.
        infos: their declarations.
        units: their units as printed.
        coordinates: the part for compiled code.
        lower, upper, scale, kinds: those of `coordinates` on the host, shape (p,).
    """

    def __init__(
        self,
        template: Any,
        *,
        fix: Sequence[str] | Mapping[str, Any] = (),
        free: Sequence[str] = (),
        tie: Mapping[str, str] | None = None,
        scales: Scales | None = None,
        records: Sequence[str] = ("",),
        trees: Sequence[Any] = (),
    ):
        scales = scales or Scales()
        self.named = NamedLeaves(template)
        self.leaves = self.named.leaves
        values = fix if isinstance(fix, Mapping) else dict.fromkeys(fix)
        self.template = self.named.with_values(
            template, {name: value for name, value in values.items() if value is not None}
        )
        self.ties = ties_of(tie or {}, self.named)
        masks = self._masks(values, free)
        self.records = tuple(records)
        self.scales = scales
        self._constants = _constants(trees)
        self._collect(masks)
        if self.ties:
            self.template = self.assembled(self.vector(self.template))

    @classmethod
    def of(cls, template: Any, **options: Any) -> ParameterSpace:
        """The space of a tree; options as in the constructor.

        Args:
            template: tree with `param` fields.
            **options: `fix` (names, or names with values), `free` (names), `tie` (expressions by name, see `hystfit.params.ties`),
                `scales`, `records` (names), `trees` (the tree of each record where these differ in leaves that are no parameters).

        Raises:
            ParameterError: an unknown or ambiguous name (the message lists the names), a name both fixed and freed, a value
                outside its bounds, a tree without parameters.
        """
        return cls(template, **options)

    # -- building ------------------------------------------------------------------------------------------------------

    def positions(self, names: str | Sequence[str]) -> list[int]:
        """Positions of names among the free parameters: of an element ("w[2]"), an array ("w") or values per record ("offset").

        Raises:
            ParameterError: no free parameter has that name.
        """
        positions: dict[int, None] = {}
        unknown = []
        for name in [names] if isinstance(names, str) else names:
            hits = [
                k for k, one in enumerate(self.names) if name in (one, one.partition("[")[0], one.partition("@")[0])
            ]
            unknown += [] if hits else [name]
            positions |= dict.fromkeys(hits)
        if unknown:
            raise ParameterError(f"no free parameter {unknown}; those are: {', '.join(self.names)}")
        return list(positions)

    def value(self, name: str) -> np.ndarray:
        """Value of a parameter, free or fixed, in the template: of one element, or of all of an array, flat.

        Raises:
            ParameterError: see `NamedLeaves.find`.
        """
        number, positions = self.named.find(name)
        flat = jax.tree_util.tree_leaves(self.template)
        return np.asarray(flat[self.leaves[number].index], dtype=float).reshape(-1)[positions]

    def _masks(self, fix: Mapping[str, Any], free: Sequence[str]) -> list[np.ndarray]:
        masks = [np.full(leaf.size, not leaf.info.fixed) for leaf in self.leaves]
        touched: dict[tuple[int, int], bool] = {}
        for names, state in ((free, True), (list(fix), False)):
            for name in names:
                number, positions = self.named.find(name)
                for k in positions:
                    if touched.setdefault((number, k), state) != state:
                        raise ParameterError(f"parameter {name!r} is listed as fixed and free at once: choose one")
                masks[number][positions] = state
        for tie in self.ties:
            number, k = tie.target
            if (number, k) in touched:
                raise ParameterError(f"parameter {tie.name!r} is tied, and listed as fixed or free at once: choose one")
            if self.leaves[number].info.per_record or self.leaves[tie.source[0]].info.per_record:
                raise ParameterError(
                    f"tie {tie.name}={tie.expression}: parameters with a value for each record cannot be tied"
                )
            masks[number][k] = False
        return masks

    def _info(self, number: int, k: int) -> ParamInfo:
        """Declaration of a free element, with bounds that also keep the elements tied to it within theirs."""
        info = self.leaves[number].info
        for tie in self.ties:
            if tie.source == (number, k):
                bounds = narrowed(info.bounds, tie, self.leaves[tie.target[0]].info.bounds)
                info = dataclasses.replace(info, bounds=bounds)
        return info

    def _collect(self, masks: list[np.ndarray]) -> None:
        flat, treedef = jax.tree_util.tree_flatten(self.template)
        names, infos, layout, sources = [], [], [], []
        for number, (leaf, mask) in enumerate(zip(self.leaves, masks, strict=True)):
            positions = tuple(int(k) for k in np.flatnonzero(mask))
            if not positions:
                continue
            layout.append((leaf.index, positions, leaf.info.per_record))
            several = leaf.info.per_record and len(self.records) > 1
            for record in range(len(self.records)) if leaf.info.per_record else (0,):
                for k in positions:
                    label = f"@{self.records[record]}" if several else ""
                    names.append(f"{self.named.element(number, k)}{label}")
                    infos.append(self._info(number, k) if self.ties else leaf.info)
                    sources.append((number, k, record if several else None))
        self.names, self.infos = tuple(names), tuple(infos)
        self.sources = tuple(sources)
        label, size = (
            functools.cache(self.scales.label),
            functools.cache(self.scales.size),
        )  # called for hundreds of weights
        self.units = tuple(label(info.unit) for info in infos)
        bounds = np.array([info.bounds for info in infos], dtype=float).reshape(-1, 2)
        finite = np.isfinite(bounds)
        kinds = np.where(finite.all(1), BOTH, np.where(finite[:, 0], LOWER, np.where(finite[:, 1], UPPER, REAL)))
        self.lower, self.upper, self.kinds = bounds[:, 0], bounds[:, 1], kinds
        self.scale = np.array([info.scale * size(info.unit) for info in infos])
        dtype = jnp.result_type(float)
        self.coordinates = Coordinates(
            leaves=tuple(flat),
            lower=to_device(self.lower, dtype),
            upper=to_device(self.upper, dtype),
            scale=to_device(self.scale, dtype),
            kinds=tuple(int(k) for k in kinds),
            layout=tuple(layout),
            treedef=treedef,
            n_records=len(self.records),
            constants=tuple(to_device(rows, dtype) for rows in self._constants.values()),
            constant_at=tuple(self._constants),
            ties=tuple(
                (*self.named.place(*tie.target), *self.named.place(*tie.source), tie.factor, tie.constant)
                for tie in self.ties
            ),
        )
        self.named.check_bounds(self.template)

    # -- vectors -------------------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.names)

    def vector(self, trees: Any) -> np.ndarray:
        """Physical vector x of a tree, or of one tree for each record."""
        structure = jax.tree_util.tree_structure
        one = structure(trees) == structure(self.template)  # a single tree may be a tuple
        several = not one and isinstance(trees, (list, tuple)) and len(trees) == len(self.records) > 1
        flats = [jax.tree_util.tree_leaves(tree) for tree in (trees if several else [trees])]
        values = []
        for number, k, record in self.sources:
            flat = flats[record if several and record is not None else 0]
            values.append(float(np.asarray(flat[self.leaves[number].index]).reshape(-1)[k]))
        # Ties narrow some bounds, and starting values may lie outside.
        return self.clip(np.array(values)) if self.ties else np.array(values)

    def unconstrained(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """z from x; values on their bound are moved inside.

        Raises:
            ParameterError: wrong length, not finite, or outside the bounds.
        """
        x = np.asarray(x, dtype=float)
        if x.shape != (len(self),):
            raise ParameterError(f"expected {len(self)} values ({', '.join(self.names)}), got shape {x.shape}")
        for name, value, low, high in zip(self.names, x, self.lower, self.upper, strict=True):
            if not (np.isfinite(value) and low <= value <= high):
                raise ParameterError(f"parameter {name!r}: start {value:g} is outside its bounds [{low:g}, {high:g}]")
        with np.errstate(all="ignore"):
            return self.coordinates.unconstrained(x, _INSIDE, np)

    def physical(self, z: Any) -> np.ndarray:
        """x from z."""
        return self.coordinates.physical(z, np)

    def slope(self, z: Any) -> np.ndarray:
        """dx/dz, element by element."""
        return self.coordinates.slope(z, np)

    def tree(self, z: Any, record: int = 0) -> Any:
        """The tree at z, with the parameters of record number `record`."""
        return self.assembled(self.physical(z), record)

    def assembled(self, x: Sequence[float] | np.ndarray, record: int = 0) -> Any:
        """The tree at x, with the parameters of record number `record`."""
        return self.coordinates.assemble(np.asarray(x, float), record)

    def of_records(
        self, x: Sequence[float] | np.ndarray, records: int, place: Callable[[Any], Any] = to_device
    ) -> Iterator[Any]:
        """The tree at x for each record in turn: the same one where no leaf differs from record to record.

        Args:
            x: physical parameters, shape (p,).
            records: their number.
            place: makes the leaves that x sets, see `Coordinates.assemble`.
        """
        own = self.coordinates.constant_at or any(per_record for *_, per_record in self.coordinates.layout)
        made = (self.coordinates.assemble(np.asarray(x, float), k, place) for k in range(records if own else 1))
        return made if own else itertools.repeat(next(made), records)

    def covariance(self, z: Any, covariance_z: np.ndarray) -> np.ndarray:
        """Covariance of x from that of z, to first order."""
        slope = self.slope(z)
        return slope[:, None] * np.asarray(covariance_z) * slope[None, :]

    @property
    def effect(self) -> np.ndarray:
        """Largest output of each free element for a value of one, shape (p,); 1 where the model declares none."""
        effects = [leaf.effects() for leaf in leaves_of(self.template)]
        return np.array([effects[number][k] for number, k, _ in self.sources])

    @property
    def weights(self) -> np.ndarray:
        """Which free elements are weights of plays, cells or relaxations, shape (p,), bool.

        The output is linear in them, and they are elements of an array that is non-negative or has more than `MANY` elements.
        """
        leaves = [self.leaves[number] for number, _, _ in self.sources]
        rows = [
            info.linear and bool(leaf.shape) and (info.bounds[0] == 0.0 or leaf.size > MANY)
            for info, leaf in zip(self.infos, leaves, strict=True)
        ]
        return np.array(rows, dtype=bool) & ~self.sources_of_ties

    @property
    def offsets(self) -> np.ndarray:
        """Which free elements only shift the output of records, shape (p,), bool."""
        shift = np.array([info.per_record or info.common for info in self.infos], dtype=bool)
        return self.linear & shift & (self.kinds == REAL)

    @property
    def linear(self) -> np.ndarray:
        """In which free elements the output is linear, shape (p,), bool; those to which others are tied do not count."""
        return np.array([info.linear for info in self.infos], dtype=bool) & ~self.sources_of_ties

    @property
    def stepwise_names(self) -> tuple[str, ...]:
        """The free elements in which the output is piecewise constant."""
        return tuple(name for name, info in zip(self.names, self.infos, strict=True) if info.stepwise)

    @property
    def mostly_linear(self) -> bool:
        """Whether the output is linear in all free elements but few, and none is tied to another."""
        linear = int(np.count_nonzero(self.linear))
        return not self.ties and linear >= _WEIGHTS * (len(self) - linear)

    @property
    def sources_of_ties(self) -> np.ndarray:
        """Which free elements others are tied to, shape (p,), bool."""
        sources = {tie.source for tie in self.ties}
        return np.array([(number, k) in sources for number, k, _ in self.sources], dtype=bool)

    @property
    def expressions(self) -> dict[str, str]:
        """The ties as the argument `tie`."""
        return {tie.name: tie.expression for tie in self.ties}

    @property
    def per_record(self) -> np.ndarray:
        """Which free elements have a value for each record, shape (p,), bool."""
        return np.array([info.per_record for info in self.infos], dtype=bool)

    @property
    def width(self) -> np.ndarray:
        """Distance between the bounds of each free element that has two, else its scale, shape (p,)."""
        return np.where(self.kinds == BOTH, self.upper - self.lower, self.scale)

    def reached(
        self, x: np.ndarray, tolerance: float = 1e-4, scale: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which free elements have reached their lower, and their upper bound, bool.

        Args:
            x: physical values, shape (..., p), like the results.
            tolerance: distance in the element's scale, or with two bounds in the width between them.
            scale: natural scales that differ from those of the space, shape (..., p).
        """
        width = self.width if scale is None else np.where(self.kinds == BOTH, self.upper - self.lower, scale)
        return x - self.lower < tolerance * width, self.upper - x < tolerance * width

    def clip(self, x: np.ndarray) -> np.ndarray:
        """x with values beyond their bounds moved onto them."""
        return np.clip(x, self.lower, self.upper)

    def fixed(self) -> list[tuple[str, float, ParamInfo]]:
        """Name, value and declaration of every fixed element, without tied ones."""
        flat = jax.tree_util.tree_leaves(self.template)
        free = {(number, k) for number, k, _ in self.sources} | {tie.target for tie in self.ties}
        rows = []
        for number, leaf in enumerate(self.leaves):
            values = np.asarray(flat[leaf.index]).reshape(-1)
            for k in range(leaf.size):
                if (number, k) not in free:
                    rows.append((self.named.element(number, k), float(values[k]), leaf.info))
        return rows

    def tied(self, x: Sequence[float] | np.ndarray) -> list[tuple[Tie, float, ParamInfo, int | None]]:
        """Of each tied element: tie, value at x, declaration, and number of the free element that it follows (None: a fixed one)."""
        if not self.ties:
            return []
        flat = jax.tree_util.tree_leaves(self.assembled(x))
        place = {source[:2]: k for k, source in enumerate(self.sources)}
        rows = []
        for tie in self.ties:
            leaf = self.leaves[tie.target[0]]
            value = float(np.asarray(flat[leaf.index]).reshape(-1)[tie.target[1]])
            rows.append((tie, value, leaf.info, place.get(tie.source)))
        return rows
