"""The next excitation: the input within the actuator's limits that reduces the standard errors most (locally D- or A-optimal design)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from hystfit.config import require_seed, verb
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.fitting.judgment.covariance import describe
from hystfit.inference.fittable import check_smooth
from hystfit.inference.information import Moments
from hystfit.inference.priors import LITTLE, LOG_WIDE
from hystfit.models.shared.simulation import simulate
from hystfit.outcome import Code, Column, Note, Severity, Status, Table, WithStatus
from hystfit.outcome.note import warn
from hystfit.outcome.table import or_none
from hystfit.params.units import with_unit
from hystfit.quality.coverage import coverage_notes
from hystfit.results.estimates import differences, grouped
from hystfit.results.result import FitResult
from hystfit.uncertainty.predicted_errors import Plan, covariance_with

_TURNS = 14  # turning levels of the optimized input
_LOOSE = 0.5  # relative error above which a combination counts as undetermined


@dataclasses.dataclass(frozen=True)
class Candidate:
    """An input and the standard errors predicted for it.

    Attributes:
        name: of its family.
        u: input, shape (T,).
        stderr: predicted standard errors, physical units, by parameter, together with the present data; None for
            parameters that remain undetermined.
        score: what was minimized (mean log error of the parameters in `aim`).
    """

    name: str
    u: np.ndarray
    stderr: dict[str, float | None]
    score: float


@dataclasses.dataclass(frozen=True)
class Design(WithStatus):
    """Inputs ranked by their predicted standard errors.

    Attributes:
        result: the fit.
        candidates: best first.
        present: predicted errors with the present data alone; None for parameters that they do not determine.
        aim: parameters whose errors count.
        closes: undetermined combinations of parameters, as text, that the best input determines.
        dt: sampling interval; None where the records have no time.
        notes: on the fit and on what the input determines.
    """

    result: FitResult
    candidates: tuple[Candidate, ...]
    present: dict[str, float | None]
    aim: tuple[str, ...]
    closes: tuple[str, ...]
    dt: float | None
    notes: tuple[Note, ...]
    verb: ClassVar[str] = "design"

    @property
    def status(self) -> Status:
        """`Status.NO_LOOP` where the fit had no loop: its predictions are meaningless; else `Status.OK`."""
        return Status.NO_LOOP if self.result.status is Status.NO_LOOP else Status.OK

    @property
    def best(self) -> Candidate:
        """The input to measure next."""
        return self.candidates[0]

    def record(self, seed: int = 0, sigma: float | None = None) -> Record:
        """A simulated measurement of the best input, with white noise of standard deviation sigma [y]; by default that of the residuals."""
        u = self.best.u
        t = None if self.dt is None else np.arange(u.size) * self.dt
        y = np.asarray(simulate(self.result.model, u, self.dt)[0])
        sd = self.result.sigma if sigma is None else sigma
        return Record(u=u, y=y + sd * np.random.default_rng(seed).normal(size=u.size), t=t, name="designed")

    def families(self, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Parameters by the name under which they are shown: arrays of many weights share one, such as "w[60]"."""
        many = lambda name, family: name if len(family) == 1 else f"{name}[{len(family)}]"
        return {many(name, family): tuple(family) for name, family in grouped(names, str)}

    @staticmethod
    def median(errors: Mapping[str, float | None], names: Sequence[str]) -> float | None:
        """Median of the standard errors of these parameters; None where the data do not determine one half of them."""
        return or_none(np.median([np.inf if (error := errors[name]) is None else error for name in names]))

    def table(self) -> Table:
        """Predicted standard errors with the present data alone, and together with each candidate; the median of many weights."""
        columns, families = [Column("")], self.families(tuple(self.present))
        for name, members in families.items():
            unit, head = self.result[members[0]].unit, name if len(members) == 1 else f"{name} median"
            columns.append(Column(with_unit(head, unit), key=name, form=".3g"))
        rows = [("present", self.present)] + [(c.name, c.stderr) for c in self.candidates]
        return Table(columns, [[label, *(self.median(errors, m) for m in families.values())] for label, errors in rows])

    def __str__(self) -> str:
        return self.text()

    __repr__ = __str__

    def text(self, width: int | None = None) -> str:
        """The proposed input, and the predicted standard errors with all inputs; a table of more than `width` columns is shown in parts."""
        lines = [
            f"{self.result.name}: next input for {', '.join(self.families(self.aim))}",
            f"proposed input: {self.best.name}",
            "predicted standard errors, with the present data alone and with one more record of each input, best first:",
            *self.table().lines(width=width),
        ]
        return "\n".join(lines + [f"note: {note}" for note in self.notes])

    def to_dict(self) -> dict[str, Any]:
        rows = [{"name": c.name, "score": c.score, "stderr": c.stderr} for c in self.candidates]
        return {
            "schema": "hystfit.design/1",
            "model": self.result.name,
            "status": str(self.status),
            "aim": list(self.aim),
            "notes": [note.to_dict() for note in self.notes],
            "present": self.present,
            "candidates": rows,
            "input": self.best.u.tolist(),
            "dt": self.dt,
            "provenance": self.result.provenance,
        }


@verb
def design(
    result: FitResult,
    *,
    low: float | None = None,
    high: float | None = None,
    samples: int = 1000,
    aim: Sequence[str] | None = None,
    method: Literal["families", "gradient"] = "gradient",
    steps: int = 150,
    seed: int = 0,
) -> Design:
    """Propose the next excitation.

    Families of signals (one and two amplitudes, decaying, growing, random reversals) and, with "gradient", turning levels
    optimized through the simulation are compared by the standard errors that the linearized model predicts from the present data, the
    new input and a wide prior, under the noise behind the standard errors of the fit. The design is local: measure, fit again, design
    again.

    Args:
        result: the fit, with its present standard errors.
        low, high: limits of the actuator; the input range of the fit by default.
        samples: length of the proposed input, at the records' sampling interval.
        aim: parameters whose errors count; all free ones by default.
        method: "families" compares signals, "gradient" also optimizes the turning points of one.
        steps: of the gradient method.
        seed: of random signals.

    Raises:
        ParameterError: limits out of order, an unknown parameter, fewer than 100 samples.
    """
    require_seed(seed)
    problem, x = result.problem, result.x
    check_smooth(problem.space, "a design")
    names = problem.space.names
    chosen = tuple(aim) if aim else names
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ParameterError(f"no free parameter {unknown}; those are: {', '.join(names)}")
    low, high = input_limits(result.data, low, high, samples)
    plan = Plan.of(result)
    now = plan.present(problem, x)
    counted = jnp.asarray([name in chosen for name in names])
    inputs = input_families(low, high, samples, seed)
    if method == "gradient":
        inputs["optimized turning points"] = _optimize(plan, now, counted, low, high, samples, steps, seed)
    covariances = {name: covariance_with(plan, now, jnp.asarray(u)) for name, u in inputs.items()}
    made = lambda name, C: Candidate(name, np.asarray(inputs[name]), _errors(plan, names, C), float(_score(C, counted)))
    candidates = [made(name, covariance) for name, covariance in covariances.items()]
    candidates.sort(key=lambda one: one.score)
    before = np.asarray(plan.covariance(now))
    errors_before = _errors(plan, names, before)
    present = {name: None if result[name].stderr is None else error for name, error in errors_before.items()}
    closes = _closed(before, np.asarray(covariances[candidates[0].name]), list(names))
    notes = _notes(result, candidates[0].name, closes, present)
    dt = result.data.sampling_interval
    return Design(result, tuple(candidates), present, chosen, tuple(closes), dt, notes)


def input_limits(data: Iterable[Record], low: float | None, high: float | None, samples: int) -> tuple[float, float]:
    """Limits of a proposed input of so many samples: those given, else the range of the inputs of the records."""
    inputs = [record.u for record in data]
    low = min(float(u.min()) for u in inputs) if low is None else low
    high = max(float(u.max()) for u in inputs) if high is None else high
    if not low < high or samples < 100:
        raise ParameterError(
            f"a proposed input needs low < high and at least 100 samples, got {low}, {high} and {samples}"
        )
    return low, high


def _errors(plan: Plan, names: Sequence[str], covariance: Array | np.ndarray) -> dict[str, float | None]:
    """Standard errors in physical units from a covariance in relative size; None where the error is that of the prior."""
    relative = np.sqrt(np.diag(np.asarray(covariance)))[: len(names)]
    known = np.where(relative < LITTLE * LOG_WIDE, relative * np.asarray(plan.size), np.nan)
    return {name: or_none(error) for name, error in zip(names, known, strict=True)}


def _notes(
    result: FitResult, best: str, closes: Sequence[str], present: Mapping[str, float | None]
) -> tuple[Note, ...]:
    """Notes on the fit, on what the best input determines, and on the limits of the design."""
    notes = []
    if not result.usable:
        text = f"the fit is not usable ({result.status}): {result.advice}"
        notes.append(Note(Code.FIT_STATUS, text, Severity.ERROR))
    for combination in closes:
        text = f"the input {best!r} determines {combination}, which the present data do not"
        notes.append(Note(Code.CLOSES, text))
    if None in present.values():
        text = f"each parameter has a prior of {100 * LOG_WIDE:.0f} % of its size; '-' where the data add no information to the prior"
        notes.append(warn(Code.NOT_DETERMINED, text))
    notes.append(Note(Code.LOCAL, "the design is optimal for the fitted values: repeat it after the next fit"))
    for note in coverage_notes(result.data):
        text = f"{note.text}. The design assumes that the model is correct and does not propose inputs that test it"
        notes.append(dataclasses.replace(note, text=text))
    reason = "the design combines the data with a wide prior and no other regularization"
    return (*notes, *differences(result.parameters, present, "the present data alone", reason))


def _score(covariance: Array, counted: Array) -> Array:
    """Mean log standard error of the parameters in `aim`, which does not depend on their units."""
    variance = jnp.diag(covariance)[: counted.shape[0]]
    return 0.5 * jnp.sum(jnp.where(counted, jnp.log(variance), 0.0)) / jnp.sum(counted)


def input_families(low: float, high: float, samples: int, seed: int) -> dict[str, np.ndarray]:
    """Signals within the limits, by name."""
    phase = np.arange(samples) / samples
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    wave = lambda cycles: np.sin(2 * np.pi * cycles * phase)
    rng = np.random.default_rng(seed)
    return {
        "sine over the range": middle + half * wave(8),
        "sine over a third of the range": middle + half / 3 * wave(8),
        "two amplitudes": middle + half * np.where(phase < 0.5, 0.4, 1.0) * wave(8),
        "decaying sine": middle + half * (1 - phase) * wave(10),
        "growing sine": middle + half * phase * wave(10),
        "random reversals": np.asarray(_through(jnp.asarray(rng.uniform(low, high, _TURNS)), samples, middle)),
    }


def _through(levels: Float[Array, " k"], samples: int, start: float) -> Float[Array, " T"]:
    """Ramps of equal duration between turning levels."""
    at = jnp.linspace(0.0, levels.shape[0], samples)
    return jnp.interp(at, jnp.arange(levels.shape[0] + 1.0), jnp.concatenate([jnp.full(1, start), levels]))


def _optimize(
    plan: Plan, now: Moments, counted: Array, low: float, high: float, samples: int, steps: int, seed: int
) -> np.ndarray:
    """Turning levels by Adam from three random starts, through the simulation."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    rng = np.random.default_rng(seed)
    starts = np.concatenate([np.tile([[1.0, -1.0]], (1, _TURNS // 2)), rng.normal(size=(2, _TURNS))])

    def score(w: Array, plan: Plan, now: Moments) -> Array:
        return _score(covariance_with(plan, now, _through(middle + half * jnp.tanh(w), samples, middle)), counted)

    adam = optax.adam(0.1, b2=0.99, eps=1e-9)

    @eqx.filter_jit
    def descend(w: Array, plan: Plan, now: Moments) -> tuple[Array, Array]:
        def once(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
            w, state, best, least = carry
            value, g = jax.value_and_grad(score)(w, plan, now)
            better = value < least
            best, least = jnp.where(better, w, best), jnp.where(better, value, least)
            update, state = adam.update(jnp.where(jnp.isfinite(g), g, 0.0), state)
            return (w + update, state, best, least), None

        begin = (w, adam.init(w), w, jnp.asarray(jnp.inf))
        _, _, best, least = jax.lax.scan(once, begin, length=steps)[0]
        return best, least

    ends = [descend(jnp.asarray(w), plan, now) for w in starts]
    best = min(ends, key=lambda end: float(end[1]))[0]
    return np.asarray(_through(middle + half * jnp.tanh(best), samples, middle))


def _closed(before: np.ndarray, after: np.ndarray, names: list[str]) -> list[str]:
    """Combinations that the present data do not determine (a relative error above one half) and the new input does."""
    p = len(names)
    values, vectors = np.linalg.eigh(before[:p, :p])
    return [
        describe(v, names)
        for value, v in zip(values, vectors.T, strict=True)
        if value > _LOOSE**2 and v @ after[:p, :p] @ v < (0.5 * _LOOSE) ** 2
    ]
