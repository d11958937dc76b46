"""What an answer rests on: its prior, single records, and whether replicated data look like the measured ones.

- Contraction: how much narrower the posterior is than the prior, 1 - (posterior spread / prior spread)^2.
- Shifts: change of a posterior mean, in posterior standard deviations, if the prior, or the data, counted twice; to first order
  log 2 Cov(quantity, log prior) and log 2 Cov(quantity, log likelihood) over the draws (Gustafson 1996, Ann. Stat. 24; Kallioinen et
  al. 2024, Stat. Comput. 34). Where both are large, with opposite signs, prior and data disagree.
- Influence: change of the means if a record is left out, by Pareto-smoothed importance sampling (Vehtari et al. 2024, JMLR 25). The
  offset of the record is integrated out first, because no other record determines it.
- Checks: quantities of the loops of replicated data beside the measured ones (Gelman, Meng and Stern 1996, Stat. Sinica 6).
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.dataset import Dataset
from hystfit.inference.density import Density
from hystfit.inference.noise.registry import NOISES
from hystfit.outcome import Code, Column, Note, Table
from hystfit.outcome.note import warn
from hystfit.outcome.table import or_none
from hystfit.results.estimates import MANY
from hystfit.results.exchange import smoothed_weights
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.results.quantity_estimates import measured_quantities
from hystfit.sampling.posterior import Posterior
from hystfit.sampling.predictive import density_of_draws, predictive_draws, residual_at

_COUNT = 1000  # draws used
_LARGE = 0.3  # shift in posterior standard deviations from which it is named
_UNRELIABLE = 0.7  # Pareto shape beyond which importance sampling does not converge (Vehtari et al. 2024)
_RARE = 0.025  # share of replicated data beyond the measured value below which the model does not reproduce it


@dataclasses.dataclass(frozen=True)
class Check:
    """A quantity of the measured loops, the median and 95 % of replicated data, and the share of these `above` it."""

    measured: float
    lower: float
    median: float
    upper: float
    above: float

    @property
    def missed(self) -> bool:
        """Whether the measured value lies outside the 95 % interval."""
        return not _RARE <= self.above <= 1 - _RARE


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """See the module.

    Attributes:
        names: of the parameters, then of the derived quantities.
        contraction: of each, shape (q,); NaN where the prior of a quantity is not known by itself.
        prior_shift, data_shift: shapes (q,).
        records: their names.
        pareto: shape parameter of the importance weights of each record, shape (R,); empty where there is no influence.
        influence: shift of each mean without a record, in posterior standard deviations, shape (R, q); NaN where the weights are
            unreliable.
        checks: by quantity.
        notes: what stands out.
    """

    names: tuple[str, ...]
    contraction: np.ndarray
    prior_shift: np.ndarray
    data_shift: np.ndarray
    records: tuple[str, ...]
    pareto: np.ndarray
    influence: np.ndarray
    checks: dict[str, Check]
    notes: tuple[Note, ...]

    def table(self) -> Table:
        """Prior against posterior, and the record whose absence moves each quantity most; without arrays of more than 12 weights."""
        heads = [
            Column("quantity"),
            Column("contraction", form=".2f"),
            Column("shift by twice the prior [sd]", key="prior_shift", form="+.2f"),
            Column("by twice the data [sd]", key="data_shift", form="+.2f"),
            Column("largest shift without a record [sd]", key="influence", form="+.2f"),
            Column("", key="record", left=True),
        ]
        return Table(heads, [self._row(k) for k in np.flatnonzero(self.shown)])

    @property
    def shown(self) -> np.ndarray:
        """Which quantities are no element of an array of more than 12 weights, shape (q,), bool."""
        arrays = Counter(name.partition("[")[0] for name in self.names)
        return np.array([arrays[name.partition("[")[0]] <= MANY for name in self.names], dtype=bool)

    def _row(self, k: int) -> list[Any]:
        rows = self.influence[:, k] if self.influence.size else np.zeros(0)
        known = np.flatnonzero(np.isfinite(rows))
        most = known[np.argmax(np.abs(rows[known]))] if known.size else None
        influence = [None, ""] if most is None else [float(rows[most]), self.records[most]]
        numbers = (self.contraction[k], self.prior_shift[k], self.data_shift[k])
        return [_label(self.names[k]), *map(or_none, numbers), *influence]

    def checks_table(self) -> Table:
        """The checks as readable text."""
        heads = [Column("quantity"), *(Column(head) for head in ("measured", "2.5 %", "median", "97.5 %"))]
        heads += [Column("share above", key="above", form=".2f")]
        cells = lambda check: [check.measured, check.lower, check.median, check.upper, check.above]
        return Table(heads, [[_label(name), *cells(check)] for name, check in self.checks.items()])

    def __str__(self) -> str:
        lines = [*self.table().lines()]
        if self.checks:
            lines += ["replicated data:", *self.checks_table().lines()]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`; unknown is null."""
        rows = {}
        for k, name in enumerate(self.names):
            without = {record: or_none(row[k]) for record, row in zip(self.records, self.influence, strict=False)}
            shifts = {"prior_shift": or_none(self.prior_shift[k]), "data_shift": or_none(self.data_shift[k])}
            rows[name] = {"contraction": or_none(self.contraction[k]), **shifts, "without": without}
        pareto = {name: or_none(k) for name, k in zip(self.records, self.pareto, strict=False)}
        checks = {name: dataclasses.asdict(check) for name, check in self.checks.items()}
        notes = [note.to_dict() for note in self.notes]
        return {"quantities": rows, "pareto": pareto, "checks": checks, "notes": notes}


def _label(name: str) -> str:
    return QUANTITIES[name].label if name in QUANTITIES else name


def sensitivity(posterior: Posterior) -> Sensitivity:
    """What the draws of a posterior rest on; 1000 of them are used."""
    flat = posterior.draws.reshape(-1, len(posterior.names))
    at = posterior.chosen(_COUNT)  # those for which `Posterior.derived` computes quantities
    derived = posterior.derived(count=_COUNT)
    values = np.column_stack([flat[at], *derived.values()])
    names = (*posterior.names, *derived)
    values = np.where(np.isfinite(values), values, np.nan)
    away = values - _mean(values)
    spread = np.sqrt(_mean(away**2) * len(away) / (len(away) - 1))
    scaled = away / np.where(spread > 0, spread, np.nan)  # unknown of a weight that is at its bound in every draw
    by_record = record_densities(posterior, flat[at])
    prior = posterior.stats["log_prior"].reshape(-1)[at]
    data = posterior.log_density.reshape(-1)[at] if by_record is None else by_record[0].sum(axis=1)
    shift = lambda log: np.log(2) * _mean(scaled * (log - log.mean())[:, None])
    pareto, influence = _influence(None if by_record is None else by_record[1], scaled)
    contraction = np.full(len(names), np.nan)
    for k, name in enumerate(posterior.names):
        if name in posterior.prior_quartiles:
            contraction[k] = _contraction(flat[:, k], *posterior.prior_quartiles[name])
    checks = _checks(posterior)
    found = Sensitivity(
        names, contraction, shift(prior), shift(data), tuple(record.name for record in posterior.result.data), pareto, influence,
        checks, (),
    )  # fmt: skip
    return dataclasses.replace(found, notes=_notes(found, posterior, independent=by_record is not None))


def _mean(rows: Float[np.ndarray, "N q"]) -> Float[np.ndarray, " q"]:
    """Mean of what is known in each column; NaN where nothing is."""
    known = np.isfinite(rows)
    return np.where(known, rows, 0.0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)


def _contraction(draws: np.ndarray, lower: float, upper: float) -> float:
    """From the quartiles of draws and prior; of the logarithms where a prior that is positive spans more than a factor of ten."""
    inner = np.quantile(draws, [0.25, 0.75])
    if lower > 0 and upper > 10 * lower and inner[0] > 0:
        inner, lower, upper = np.log(inner), np.log(lower), np.log(upper)
    return float(1 - ((inner[1] - inner[0]) / (upper - lower)) ** 2)


def _influence(log_densities: np.ndarray | None, scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pareto shapes of the weights without each record, and the shifts of the means."""
    if log_densities is None or log_densities.shape[1] < 2:
        return np.zeros(0), np.zeros((0, scaled.shape[1]))
    weights, pareto = smoothed_weights(-log_densities.T)
    shifts = np.nansum(weights[:, :, None] * scaled, axis=1)
    return pareto, np.where(pareto[:, None] <= _UNRELIABLE, shifts, np.nan)


def _checks(posterior: Posterior) -> dict[str, Check]:
    """Quantities of the measured loops beside those of replicated data; none without closed loops."""
    data = posterior.result.data
    measured = measured_quantities(data)
    if not measured:
        return {}
    rows = [predictive_draws(posterior, record, 100, 1) for record in data]
    replicated = [
        measured_quantities(Dataset(tuple(record.replace(y=y[k]) for record, y in zip(data, rows, strict=True))))
        for k in range(len(rows[0]))
    ]
    checks = {}
    for name, value in measured.items():
        others = np.array([values[name] for values in replicated if name in values])
        if others.size:
            low, middle, high = np.quantile(others, [0.025, 0.5, 0.975])
            above = float(np.mean(others > value) + 0.5 * np.mean(others == value))
            checks[name] = Check(value, float(low), float(middle), float(high), above)
    return checks


def _notes(found: Sensitivity, posterior: Posterior, *, independent: bool) -> tuple[Note, ...]:
    notes = []
    joined = lambda names: ", ".join(map(_label, names))
    # The noise follows the misfit, which data that count twice always lower.
    noise = np.isin(found.names, posterior.names[len(posterior.result.free_names) :])
    large = (np.abs(found.prior_shift) > _LARGE) & found.shown & ~noise
    opposed = large & (np.abs(found.data_shift) > _LARGE) & (found.prior_shift * found.data_shift < 0)
    if opposed.any():
        which = joined(np.array(found.names)[opposed])
        notes.append(warn(Code.PRIOR, f"prior and data are inconsistent for {which}: check both"))
    if (large & ~opposed).any():
        which = joined(np.array(found.names)[large & ~opposed])
        notes.append(warn(Code.PRIOR, f"the prior matters: doubling its weight moves {which} by more than {_LARGE} sd"))
    unreliable = [name for name, k in zip(found.records, found.pareto, strict=False) if not k <= _UNRELIABLE]
    if unreliable:
        text = f"the influence of {', '.join(unreliable)} is too large for importance sampling: fit again without it"
        notes.append(warn(Code.INFLUENCE, text))
    if not independent:
        text = f"the influence of single records is not known: under noise {posterior.noise!r} they share an error"
        notes.append(Note(Code.INFLUENCE, text))
    for name, check in found.checks.items():
        if check.missed:
            text = (
                f"{_label(name)}: measured {check.measured:.4g}, replicated data {check.lower:.4g} to {check.upper:.4g} (95 %): "
                "the model does not reproduce it"
            )
            notes.append(warn(Code.INCOMPLETE, text))
    return tuple(notes)


def record_densities(posterior: Posterior, draws: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Log densities of every record at the draws, (draws, R), also with its offset integrated out; None where records share shapes."""
    noise = NOISES.make(posterior.noise)
    if noise.has_shapes:
        return None
    problem = posterior.result.problem.with_loss("linear").with_noise(noise)
    own, center, sd = _offsets(posterior)
    prior = (jnp.asarray(own), jnp.asarray(center), jnp.asarray(sd))
    density, about = density_of_draws(problem, posterior.result.x)
    rows = _densities(density, jnp.asarray(draws), prior, about)
    return np.asarray(rows[0]), np.asarray(rows[1])


def _offsets(posterior: Posterior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which parameter is the offset of each record, shape (R, p), bool, and mean and standard deviation of its normal prior, (R,)."""
    space = posterior.result.problem.space
    own = np.zeros((len(posterior.result.data), len(space)), dtype=bool)
    for k, (*_, record) in enumerate(space.sources):
        if record is not None and space.offsets[k] and not own[record].any():
            own[record, k] = True
    quartiles = np.array(
        [posterior.prior_quartiles[space.names[row.argmax()]] if row.any() else [-1, 1] for row in own]
    )
    return own, quartiles.mean(axis=1), np.diff(quartiles, axis=1)[:, 0] / 1.349


@eqx.filter_jit
def _densities(density: Density, draws: Array, prior: Any, about: Any) -> tuple[Array, Array]:
    """Of every record at each draw; `about` as for `residual_at`."""
    direction = prior[0].any(axis=0).astype(draws.dtype)

    def one(x: Array) -> tuple[Array, Array]:
        if about is None:
            residual, column = density.objective.linearize(x[: density.p], direction[None])
        else:
            residual, column = residual_at(density, x, about), (about[1] @ direction)[..., None]
        return _of_records(density, x, residual, column, *prior)

    return jax.lax.map(one, draws)


def _of_records(
    density: Density,
    x: Array,
    residual: Float[Array, "R T"],
    column: Float[Array, "R T 1"],
    own: Array,
    center: Float[Array, " R"],
    sd: Float[Array, " R"],
) -> tuple[Float[Array, " R"], Float[Array, " R"]]:
    """Log densities of records at one draw, and those with the offset integrated out.

    By p(y) = p(y | offset) p(offset) / p(offset | y), whose last density is normal under Gaussian noise.
    """
    noise, setting = density.noise.assemble(x[density.p :]), density.setting
    e, logs = noise.whiten(setting, jnp.concatenate([-residual[..., None], column], axis=-1))
    on = setting.weight > 0
    plain = jnp.sum(jnp.where(on, noise.density(e[..., 0], logs), 0.0), axis=1)
    if not noise.gaussian:
        return plain, plain
    precision = jnp.sum(e[..., 1] ** 2, axis=1) + sd**-2
    offset = own.astype(x.dtype) @ x[: density.p] - center
    shift = (jnp.sum(e[..., 0] * e[..., 1], axis=1) - offset * sd**-2) / precision
    prior = -0.5 * (offset / sd) ** 2 - jnp.log(sd)
    posterior = -0.5 * precision * shift**2 + 0.5 * jnp.log(precision)
    return plain, jnp.where(own.any(axis=1), plain + prior - posterior, plain)
