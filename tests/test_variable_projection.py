"""Derivatives of what eliminated weights leave, against differences that solve for the weights anew."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.fit_setup import started_problem
from hystfit.fitting.solvers.ridge import eliminated
from hystfit.fitting.solvers.smooth_weights import eliminated_smooth
from hystfit.fitting.solvers.variable_projection import Eliminated
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models.registry import make_model
from hystfit.quality.host_operators import recursion


def _problem(model: str) -> Problem:
    """Two records of a saturating loop that lags, with noise, so that weights end at their bound and residuals are not small."""
    rng, t, records = np.random.default_rng(3), 0.01 * np.arange(300), []
    for phase in (0.3, 1.1):
        u = np.sin(2 * np.pi * t + phase) * np.linspace(1.0, 0.5, 300)
        y = np.tanh(2 * np.interp(t - 0.04, t, u)) + 0.05 * rng.normal(size=300)
        records.append(hf.Record(u=u, y=y, t=t, name=f"at {phase}"))
    return started_problem(make_model(model), hf.Dataset.of(records))[0]


def _left(problem: Problem, x: np.ndarray, others: np.ndarray, strength: float = 1e-4) -> Eliminated:
    if problem.model.estimator != "preisach":
        return eliminated(problem, x, others, strength)
    split = Split.of(problem.space, list(problem.data), x, held=problem.held_out)
    return eliminated_smooth(problem, x, others, split, strength)


def _change(
    problem: Problem, x: np.ndarray, others: np.ndarray, k: int, steps: tuple[float, float], strength: float = 1e-4
) -> np.ndarray:
    """Difference of what is left at two steps from an unconstrained parameter, with weights that are solved for at both."""
    sides = []
    for step in steps:
        z = np.array(problem.space.unconstrained(x))
        z[k] += step
        sides.append(_left(problem, np.array(problem.space.physical(z)), others, strength).left)
    return (sides[1] - sides[0]) / (steps[1] - steps[0])


MODELS = ("lag+prandtl-ishlinskii", "prandtl-ishlinskii+relaxation", "lag+preisach:n=8", "preisach:n=8+relaxation")


@pytest.mark.parametrize("model", MODELS)
def test_slopes_are_those_with_weights_solved_for_where_the_model_fits(model: str) -> None:
    """What Kaufman's derivatives leave out vanishes with the residuals. The output has kinks where a reversal is on the edge of a cell."""
    rng, made = np.random.default_rng(1), _problem(model)
    x, others = made.space.vector(made.model), np.flatnonzero(~made.space.linear)
    x[made.space.linear] = rng.uniform(0.1, 1.0, np.count_nonzero(made.space.linear))
    outputs = made.predict(x)
    records = [record.replace(y=np.array(y)) for record, y in zip(made.data, outputs, strict=True)]
    problem = Problem(made.model, hf.Dataset.of(records))
    slopes = _left(problem, x, others, 1e-9).slopes()
    for k, slope in zip(others, slopes.T, strict=True):
        change = _change(problem, x, others, k, (0.0, 1e-3), 1e-9)
        assert np.linalg.norm(slope - change) < 0.02 * np.linalg.norm(change)


@pytest.mark.parametrize("model", MODELS)
def test_slopes_give_the_gradient_of_the_sum_of_squares(model: str) -> None:
    """Kaufman's derivatives leave a part out that is orthogonal to the residuals: the gradient is exact."""
    problem = _problem(model)
    x, others = problem.space.vector(problem.model), np.flatnonzero(~problem.space.linear)
    found = _left(problem, x, others)
    gradient = found.slopes().T @ found.left
    for k, slope in zip(others, gradient, strict=True):
        assert slope == pytest.approx(_change(problem, x, others, k, (-1e-3, 1e-3)) @ found.left, rel=0.02, abs=1e-3)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 100])
def test_a_recursion_of_many_columns_is_that_of_each(count: int) -> None:
    rng = np.random.default_rng(0)
    columns, kept = rng.normal(size=(count, 80)), rng.uniform(-1.0, 1.0, count)
    found, by_hand = recursion((2.0, -kept), columns), np.zeros((count, 80))
    for k, row in enumerate(columns):
        by_hand[k] = (row + (kept[k - 1] * by_hand[k - 1] if k else 0.0)) / 2.0
    np.testing.assert_allclose(found, by_hand, rtol=1e-12, atol=1e-14)
