"""A fit that is ready to be solved: problem, estimator and starting points; and its solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from hystfit.data.circulation import SLACK
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.fitting.solvers.multistart import starting_vectors, with_record_parameters
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge
from hystfit.inference.fittable import check_fittable
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note
from hystfit.params.space import ParameterSpace
from hystfit.quality.faults import saturated_samples
from hystfit.quality.summary import outliers_of

_MANY = 4  # non-negative weights from which the convex solve is the default


@dataclasses.dataclass(frozen=True)
class FitSetup:
    """A fit that is ready to be solved by `method`, an estimator or its name, from `points`, the best first.

    `candidates` are problems with different initial states, of which `problem` has the smallest cross-validation error; empty without a
    choice.
    """

    problem: Problem
    method: str | AbstractEstimator
    points: tuple[AbstractHysteresis, ...]
    notes: tuple[Note, ...] = ()
    candidates: tuple[Problem, ...] = ()


def set_up_fit(
    model: AbstractHysteresis,
    data: Dataset,
    options: FitOptions,
    *,
    held: bool = False,
    notes: tuple[Note, ...] = (),
    started: tuple[AbstractHysteresis, ...] = (),
) -> FitSetup:
    """Set up a fit: the problem, its estimator and starting points; `notes` are those on earlier choices.

    Isolated outliers of the output are fitted only with a noise model or a robust loss. With `held`, parameters in `fix` without a value
    keep that of the model, instead of one estimated from the data. Models with starting values, the best first, are `started` where they
    are known.
    """
    check_fittable(model, data)
    data = without_faults(data, keep_outliers=not options.plain_noise or options.loss != "linear")
    points: tuple[AbstractHysteresis, ...] = (model,)
    fix, free, start = options.fix, options.free, options.start
    common: dict[str, Any] = {"free": free, "tie": options.tie, "loss": options.loss, "spacing": options.spacing}
    if start != "model":
        fix = _fixed_values(model, fix) if held else fix
        problem, points = started_problem(model, data, started, fix=fix, **common)
        if isinstance(start, Mapping):
            points = (points[0].replace(**start),)
            problem = Problem(points[0], data, fix=fix, **common)
        model = points[0]
    else:
        problem = Problem(model, data, fix=fix, **common)
    name = choose_method(problem) if options.method == "auto" else options.method
    candidates: tuple[Problem, ...] = ()
    if name == "convex" and start != "model" and model.has_rest:
        problem, candidates, of_rest = _choose_rest(problem, fix, common)
        notes = (*notes, *of_rest)
    return FitSetup(problem, name, points, notes, candidates)


def without_faults(data: Dataset, *, keep_outliers: bool = False) -> Dataset:
    """Records in which samples of a saturated sensor have no weight, nor isolated outliers of the output unless they are kept.

    If the weights differ, as for stated standard deviations, they describe the noise, and no sample counts as an outlier.
    """

    def cleaned(record: Record) -> Record:
        faulty = saturated_samples(record.u, record.y)
        stated = np.ptp(record.weight[record.used]) > 0 if record.used.any() else False
        faulty[[] if keep_outliers or stated else outliers_of(record)] = True
        faulty &= record.used
        return record.replace(weight=np.where(faulty, 0.0, record.weight)) if faulty.any() else record

    return data.map(cleaned)


def started_problem(
    model: AbstractHysteresis, data: Dataset, started: tuple[AbstractHysteresis, ...] = (), **options: Any
) -> tuple[Problem, tuple[AbstractHysteresis, ...]]:
    """The problem of a model with starting values from the records, and all models to start from; `started` has them already."""
    check_fittable(model, data)
    points = started or model.starting_points(list(data.map(model.prepared)))
    return Problem(points[0], data, **options), points


def _fixed_values(model: AbstractHysteresis, fix: Sequence[str] | Mapping[str, Any]) -> Mapping[str, Any]:
    """`fix` with the model's own values where it gives none, so that values estimated from the data do not replace them."""
    values = dict(fix) if isinstance(fix, Mapping) else dict.fromkeys(fix)
    return {name: ParameterSpace.of(model).value(name) if value is None else value for name, value in values.items()}


def choose_method(problem: Problem) -> str:
    """The estimator that suits a model: a closed form for its weights where there are many, else Levenberg-Marquardt."""
    if problem.objective.loss != "linear" or problem.space.ties:
        return "lm"
    if problem.model.estimator is not None:
        return problem.model.estimator
    weights = sum(info.linear and info.bounds[0] == 0.0 for info in problem.space.infos)
    return "convex" if weights >= _MANY else "lm"


def solve(
    problem: Problem,
    method: str | AbstractEstimator,
    starts: int,
    seed: int,
    points: Sequence[AbstractHysteresis] = (),
    worth: float = np.inf,
) -> Estimate:
    """Run an estimator from `points`, the best first, or from the problem's model and a Latin hypercube about it.

    `seed` is that of the hypercube. The fit may stop early if its rms error on held-out samples exceeds `worth` [y].
    """
    estimator = ESTIMATORS.make(method).up_to(worth)
    return estimator.estimate(problem, starting_vectors(problem, starts if estimator.needs_starts else 1, seed, points))


def _choose_rest(
    problem: Problem, fix: Sequence[str] | Mapping[str, Any], common: Mapping[str, Any]
) -> tuple[Problem, tuple[Problem, ...], list[Note]]:
    """Choose the input at which the device rested before the records, zero or the first one, by cross-validation."""
    span = 2 * problem.scales.u
    if all(abs(record.u[0]) <= SLACK * span for record in problem.data):
        return problem, (), []
    first = problem.model.with_rest("first")
    if eqx.tree_equal(first, problem.model):  # chosen by the user
        return problem, (), []
    other = Problem(first, problem.data, fix=fix, **common)
    scores = []
    for candidate in (problem, other):
        x = with_record_parameters(candidate, candidate.space.vector(candidate.model))
        scores.append(float(fit_ridge(LinearSystem.of(candidate, x)).score))
    best, where = (problem, "at zero input") if scores[0] <= scores[1] else (other, "at its first input")
    gain = 1 - min(scores) / max(scores)
    text = f"the device is assumed to have rested {where} before the record (cross-validation error {100 * gain:.0f} % lower)"
    return best, (problem, other), [Note(Code.CHOICE, text)]
