"""`design_population`: which device to measure next, and with which input, to learn how devices scatter."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_seed, verb
from hystfit.errors import ParameterError
from hystfit.outcome import Code, Column, Note, Status, Table, WithStatus
from hystfit.outcome.table import or_none
from hystfit.outcome.wrapping import shortened
from hystfit.population.devices import DRAWS, Device, marginal
from hystfit.population.hierarchy import Hierarchy, correlations_of
from hystfit.population.population_fit import PopulationFit
from hystfit.uncertainty.input_design import input_families, input_limits
from hystfit.uncertainty.predicted_errors import Plan, likelihood_information

_ESTIMATES = 400  # drawn for each candidate, from as many of those draws
_LEAST = 0.02  # effective fraction of the draws below which an expected fall is not known


@dataclasses.dataclass(frozen=True)
class Beliefs:
    """Draws of a population, and of the quantities that are to become known."""

    effects: Float[np.ndarray, "n q p"]  # B, shape (n, q, p)
    covariance: Float[np.ndarray, "n p p"]  # Sigma, shape (n, p, p)
    means: Float[np.ndarray, "D p"]  # means, precisions: of the devices' likelihoods, shapes (D, p) and (D, p, p)
    precisions: Float[np.ndarray, "D p p"]
    design: Float[np.ndarray, "D q"]  # covariates of the devices, shape (D, q)
    quantities: Float[np.ndarray, "n m"]  # values at the draws, shape (n, m)
    # standard normal numbers, the same for all candidates, shape (estimates, p)
    noise: Float[np.ndarray, "estimates p"]

    @classmethod
    def of(
        cls, drawn: Hierarchy, means: np.ndarray, precisions: np.ndarray, design: np.ndarray, seed: int = 0
    ) -> Beliefs:
        """Quantities: logarithms of the standard deviations, correlations (below the diagonal, by row), then the mean device."""
        p, every = means.shape[1], drawn.joined
        kept = np.linspace(0, len(every.effects) - 1, min(DRAWS, len(every.effects))).astype(int)
        effects, covariance = every.effects[kept], every.covariance[kept]
        sd = np.sqrt(np.einsum("nii->ni", covariance))
        below = np.tril_indices(p, -1)
        correlations = correlations_of(covariance)[:, below[0], below[1]]
        quantities = np.concatenate([np.log(sd), correlations, effects[:, 0]], axis=1)
        noise = np.random.default_rng(seed).normal(size=(_ESTIMATES, p))
        return cls(effects, covariance, means, precisions, design, quantities, noise)

    @property
    def sd(self) -> Float[np.ndarray, " m"]:
        """Posterior standard deviations of the quantities."""
        return self.quantities.std(axis=0)

    def of_new(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a new device at the mean of the covariates, by draw, shapes (n, p) and (n, p, p)."""
        return self.effects[:, 0], self.covariance

    def of_device(self, d: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a measured device given the population and its data, by draw."""
        inverse = np.linalg.inv(self.covariance)
        middle = np.einsum("q,nqp->np", self.design[d], self.effects)
        covariance = np.linalg.inv(self.precisions[d] + inverse)
        pull = self.precisions[d] @ self.means[d] + np.einsum("nij,nj->ni", inverse, middle)
        return np.einsum("nij,nj->ni", covariance, pull), covariance

    def expected_fall(
        self, before: tuple[np.ndarray, np.ndarray], precision: Float[np.ndarray, "p p"]
    ) -> Float[np.ndarray, " m"]:
        """Expected fall of the posterior variances of the quantities, as fractions, by an estimate of this precision (0 where it leaves a
        direction open) of a device with mean and covariance `before`; NaN where the draws are too few.
        """
        weights = self._weights(before, precision)
        effective = 1.0 / np.sum(weights**2, axis=1)
        if np.median(effective) < _LEAST * weights.shape[1]:
            return np.full(self.quantities.shape[1], np.nan)
        away = (self.quantities - self.quantities.mean(axis=0)) / np.maximum(self.sd, 1e-300)
        variance = weights @ away**2 - (weights @ away) ** 2
        unbiased = (1 - 1 / weights.shape[1]) / (1 - 1 / effective)  # of finitely many effective draws
        return np.clip(1 - np.mean(unbiased[:, None] * variance, axis=0), 0.0, 1.0)

    def _weights(self, before: tuple[np.ndarray, np.ndarray], precision: np.ndarray) -> np.ndarray:
        """Weights of the draws under estimates drawn from some of them, shape (estimates, n); each row adds up to one."""
        values, vectors = np.linalg.eigh(precision)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T  # of unit noise: root z + N(0, I)
        mean, covariance = before[0] @ root.T, root @ before[1] @ root.T + np.eye(len(values))
        factor = np.linalg.cholesky(covariance)
        at = np.linspace(0, len(mean) - 1, len(self.noise)).astype(int)
        estimates = mean[at] + np.einsum("kij,kj->ki", factor[at], self.noise)
        inverse = np.linalg.inv(factor)
        scores = inverse @ estimates.T - inverse @ mean[:, :, None]  # (n, p, estimates)
        log_w = -0.5 * np.sum(scores**2, axis=1) - np.log(np.einsum("nii->ni", factor)).sum(axis=1)[:, None]
        weights = np.exp(log_w - log_w.max(axis=0)).T
        return weights / weights.sum(axis=1, keepdims=True)


Goal = Literal["scatter", "mean"]
AS_MEASURED = "as measured"
COLUMNS = (
    "variance: expected change, in the mean over the aim; sd: error of the standard deviations; correlation: error of the correlations; "
    "mean: error of the mean device over the standard deviation; medians over the parameters."
)


@dataclasses.dataclass(frozen=True)
class Measurement:
    """A candidate, and what the population is expected to become known to by it."""

    device: str | None  # that is measured again; None for a new one
    name: str  # of the input
    u: np.ndarray  # input, shape (T,)
    # expected fall of the posterior variances of the aim, as a fraction, in the mean; None where it is not known
    fall: float | None
    # expected posterior standard deviations by quantity: of the logarithm of "sd of k", of "correlation of k, c", and of "mean of k" in
    # unconstrained coordinates; None where they are not known
    errors: dict[str, float | None]

    @property
    def label(self) -> str:
        """Device and input."""
        return f"{self.device or 'a new device'}, {self.name}"


@dataclasses.dataclass(frozen=True, repr=False)
class PopulationDesign(WithStatus):
    """Measurements ranked by what they tell about a population.

    Attributes:
        population: so far.
        candidates: best first.
        present: posterior standard deviations now, as in `Measurement.errors`.
        aim: parameters that count.
        goal: "scatter" or "mean" of these.
        counted: quantities whose variances are to fall.
        dt: sampling interval of the inputs; None where the records have no time.
        notes: on the limits of the design.
    """

    population: PopulationFit
    candidates: tuple[Measurement, ...]
    present: dict[str, float]
    aim: tuple[str, ...]
    goal: Goal
    counted: tuple[str, ...]
    dt: float | None
    notes: tuple[Note, ...]
    verb: ClassVar[str] = "population"

    @property
    def status(self) -> Status:
        """That of the population."""
        return self.population.status

    @property
    def best(self) -> Measurement:
        """What to measure next."""
        return self.candidates[0]

    def table(self, most: int | None = None) -> Table:
        """Errors now, and expected with each of at most so many candidates: medians over the parameters of the aim."""
        columns = [Column(""), Column("variance [%]", form=".1f"), Column("sd [%]", form=".3g")]
        columns += [Column("correlation", form=".3g"), Column("mean [sd]", form=".3g")]
        rows: list[list[Any]] = [["present", None, *self._medians(self.present)]]
        for one in self.candidates[:most]:
            rows.append([one.label, None if one.fall is None else -100 * one.fall, *self._medians(one.errors)])
        return Table(columns, rows)

    def _medians(self, errors: Mapping[str, float | None]) -> Iterator[float | None]:
        """Error of the standard deviations [%], of the correlations, and of the mean over the standard deviation."""
        variances = np.median(np.einsum("cnii->cni", self.population.drawn.covariance), axis=(0, 1))
        sizes = dict(zip(self.population.names, np.sqrt(variances), strict=True))
        for kind in ("sd", "correlation", "mean"):
            values = []
            for label, error in errors.items():
                what, _, of = label.partition(" of ")
                if what == kind and set(of.split(", ")) <= set(self.aim):
                    size = {"sd": 0.01, "correlation": 1.0}.get(kind) or sizes[of]
                    values.append(np.nan if error is None else error / size)
            yield or_none(np.median(values)) if values else None

    def __str__(self) -> str:
        lines = [f"{self.population.model}: next measurement for the {self.goal} of {', '.join(self.aim)}"]
        lines.append(f"proposed: {self.best.label}")
        lines.append("errors now, and expected after one more measurement, best first:")
        table = self.table().lines()
        lines += [*shortened(table, len(table) - len(self.candidates) + 12), COLUMNS]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {
            "schema": "hystfit.population-design/1",
            "model": self.population.model,
            "aim": list(self.aim),
            "goal": self.goal,
            "counted": list(self.counted),
            "present": self.present,
            "candidates": [
                {"device": c.device, "input": c.name, "fall": c.fall, "errors": c.errors} for c in self.candidates
            ],
            "u": self.best.u.tolist(),
            "dt": self.dt,
            "notes": [note.to_dict() for note in self.notes],
        }


@verb
def design_population(
    population: PopulationFit,
    inputs: Mapping[str, np.ndarray] | None = None,
    *,
    low: float | None = None,
    high: float | None = None,
    samples: int = 1000,
    aim: Sequence[str] | None = None,
    goal: Goal = "scatter",
    seed: int = 0,
) -> PopulationDesign:
    """Rank what to measure next: a new device, or one already measured once more, each with several inputs.

    The precision that an input gives follows from the model at the mean device, or at the fitted values of a device measured again, under
    the noise of the fits. By how much the variances of standard deviations and correlations are then expected to fall is computed from
    the draws of the population, without fitting anything again.

    Args:
        population: so far.
        inputs: by name, shape (T,), at the sampling interval of the records; by default signals of one and two amplitudes, decaying,
            growing, and with random reversals (those of `hystfit.design`). "as measured" is always among them: the records of the
            device once more, for a new device those of a typical one.
        low, high: limits of the default inputs; by default the range of the fits.
        samples: length of the default inputs.
        aim: parameters that count; all by default.
        goal: "scatter" (standard deviations of the aim and correlations within it) or "mean" (of its values over the population).
        seed: of random inputs and of the estimates drawn.

    Returns:
        All candidates with expected errors, best first.

    Raises:
        ParameterError: limits out of order, fewer than 100 samples, an unknown parameter or goal, an input that is not of one dimension.
    """
    require_seed(seed)
    names = population.names
    chosen = tuple(aim) if aim else names
    if unknown := [name for name in chosen if name not in names]:
        raise ParameterError(f"no parameter {unknown} scatters; those are: {', '.join(names)}")
    if goal not in get_args(Goal):
        raise ParameterError(f"goal must be {' or '.join(get_args(Goal))}, got {goal!r}")
    signals = _signals(population, inputs, low, high, samples, seed)
    devices = population.devices
    means, precisions = np.stack([d.mean for d in devices]), np.stack([d.precision for d in devices])
    beliefs = Beliefs.of(population.drawn, means, precisions, population.design, seed)
    labels = quantities_of(names)
    counted = np.array([_counts(label, chosen, goal) for label in labels])
    candidates = []
    for number, device in [(None, _typical(devices)), *enumerate(devices)]:
        before = beliefs.of_new() if number is None else beliefs.of_device(number)
        for name, u, precision in _measured(population, device, signals, again=number is not None):
            fall = beliefs.expected_fall(before, precision)
            known = bool(np.isfinite(fall).all())
            errors = dict(zip(labels, (beliefs.sd * np.sqrt(1 - fall)).tolist(), strict=True))
            errors, mean = (errors, float(fall[counted].mean())) if known else (dict.fromkeys(labels), None)
            candidates.append(Measurement(None if number is None else device.name, name, u, mean, errors))
    candidates.sort(key=lambda one: -np.inf if one.fall is None else -one.fall)
    present = dict(zip(labels, beliefs.sd.tolist(), strict=True))
    dt = devices[0].result.data.sampling_interval
    shown = tuple(label for label, on in zip(labels, counted, strict=True) if on)
    note = Note(Code.LOCAL, "the ranking is for one measurement, by what is known now: repeat it after the next one")
    return PopulationDesign(population, tuple(candidates), present, chosen, goal, shown, dt, (note,))


def quantities_of(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the quantities of `Beliefs`."""
    pairs = [f"correlation of {names[a]}, {names[b]}" for a in range(len(names)) for b in range(a)]
    return (*(f"sd of {name}" for name in names), *pairs, *(f"mean of {name}" for name in names))


def _counts(label: str, aim: Sequence[str], goal: Goal) -> bool:
    """Whether a quantity is part of the aim."""
    kind, _, of = label.partition(" of ")
    return (kind == "mean") == (goal == "mean") and set(of.split(", ")) <= set(aim)


def _signals(
    population: PopulationFit,
    given: Mapping[str, np.ndarray] | None,
    low: float | None,
    high: float | None,
    samples: int,
    seed: int,
) -> dict[str, np.ndarray]:
    if given is not None:
        signals = {name: np.asarray(u, dtype=float) for name, u in given.items()}
        if bad := [name for name, u in signals.items() if u.ndim != 1 or u.size < 2 or not np.isfinite(u).all()]:
            raise ParameterError(f"input {bad[0]!r} must be finite numbers of shape (T,)")
        return signals
    every = (record for device in population.devices for record in device.result.data)
    return input_families(*input_limits(every, low, high, samples), samples, seed)


def _typical(devices: Sequence[Device]) -> Device:
    """The device whose data are of median precision."""
    size = np.mean([np.diag(d.precision) for d in devices], axis=0)
    known = [float(np.sum(np.log(np.diag(d.precision) / np.maximum(size, 1e-300) + 1e-12))) for d in devices]
    return devices[int(np.argsort(known)[len(devices) // 2])]


def _measured(
    population: PopulationFit, device: Device, signals: Mapping[str, np.ndarray], again: bool
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Inputs with the precisions in z that they give: of the device once more, or of a new one with its noise at the mean device."""
    common = population.common
    z = device.mean if again else population.drawn.effects[:, :, 0].mean(axis=(0, 1))
    own = np.flatnonzero(common.space.per_record[common.at])  # of a record that is measured again, new ones
    precision = device.precision
    if again and own.size:
        kept = np.setdiff1d(np.arange(len(common.at)), own)
        precision = np.zeros_like(device.precision)
        precision[np.ix_(kept, kept)] = marginal(device.precision, kept)
    yield AS_MEASURED, np.asarray(device.result.data[0].u), precision
    x = device.x.copy()
    x[common.at] = common.x_of(z)
    plan = Plan.of(device.result)
    plan = dataclasses.replace(
        plan,
        x=jnp.asarray(device.problem.space.clip(x)),
        information=likelihood_information(device.problem.noise),  # type: ignore[arg-type]
    )
    size = np.asarray(plan.size)[[*range(x.size), *plan.own]]
    scale = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    fold = np.eye(x.size)[[*range(x.size), *plan.own]]  # the record of a new device has the parameters of the device
    for name, u in signals.items():
        information = scale[:, None] * np.asarray(_information(plan, jnp.asarray(u))) * scale
        if not again:
            information = fold.T @ information @ fold
        yield name, u, common.precision(information, z)


@eqx.filter_jit
def _information(plan: Plan, u: Array) -> Array:
    """About the parameters of the fit and those of the further record, in relative size."""
    return plan.information.matrix(plan.further(u))  # type: ignore[attr-defined]
