"""Records with parameters of their own: derivatives by record, and what is eliminated and left out by record."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.fitting.fit_setup import started_problem
from hystfit.fitting.solvers.lanes import Stack, descend_lanes
from hystfit.inference.objective import linearized
from hystfit.inference.problem import Problem


def loops(count: int, seed: int = 0) -> Dataset:
    """Sine loops of different lengths and amplitudes, each with an offset of its own."""
    rng, records = np.random.default_rng(seed), []
    for k in range(count):
        t = np.arange(150 + 20 * (k % 4)) * 0.01
        u = (1 + 0.2 * k) * np.sin(2 * np.pi * (1 + 0.3 * k) * t)
        y = np.asarray(hf.simulate(hf.BoucWen(c=0.8, mu=0.3, tau=0.4, rho=0.2), u)[0])
        records.append(hf.Record(u=u, y=y + 0.1 * k + 0.01 * rng.normal(size=t.size), t=t, name=str(k)))
    return Dataset(tuple(records))


@pytest.fixture(scope="module")
def problem() -> Problem:
    return started_problem(hf.BoucWen(), loops(4))[0]


def dense(function, at: np.ndarray) -> np.ndarray:
    """Derivatives of a function of p parameters along every one of them, last axis p."""
    push = lambda direction: jax.jvp(function, (jnp.asarray(at),), (direction,))[1]
    return np.moveaxis(np.asarray(jax.vmap(push)(jnp.eye(at.size))), 0, -1)


def test_the_parameters_of_a_record_are_those_that_move_its_output(problem):
    x = problem.space.vector(problem.model)
    J = dense(problem.objective.residual, x)
    own = problem.objective.coordinates.own
    assert problem.objective.apart
    for record, positions in enumerate(own):
        moved = np.flatnonzero(np.abs(J[record]).max(axis=0))
        np.testing.assert_array_equal(moved, np.sort(positions))
    alone = Problem(hf.BoucWen(), loops(1))
    assert not alone.objective.apart


def test_derivatives_by_record_are_those_of_all_parameters(problem):
    objective, x = problem.objective, problem.space.vector(problem.model)
    J = dense(objective.residual, x)
    residual, found = linearized(objective, x)
    np.testing.assert_allclose(residual, objective.residual(jnp.asarray(x)), atol=1e-13)
    np.testing.assert_allclose(found, J, atol=1e-12)
    some = np.array([1, 4, x.size - 1])
    np.testing.assert_allclose(linearized(objective, x, some)[1], J[..., some], atol=1e-12)
    z = problem.space.unconstrained(x)
    misfit, along = objective.linearize_at(jnp.asarray(z))
    np.testing.assert_allclose(misfit, objective.misfit_at(jnp.asarray(z)), atol=1e-13)
    np.testing.assert_allclose(np.asarray(along).T, dense(objective.misfit_at, np.asarray(z)), atol=1e-12)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_descent_that_eliminates_by_record_ends_where_the_gradient_vanishes(loss):
    problem, points = started_problem(hf.BoucWen(), loops(4), loss=loss)
    start = np.asarray(problem.space.unconstrained(problem.space.vector(points[0])))
    stack = Stack.of([problem.objective])
    found = descend_lanes(stack, np.zeros(1, int), start[None] + 0.05, gain=1e-13, steps=60)
    assert found.converged.all()
    misfit = np.asarray(problem.objective.misfit_at(jnp.asarray(found.normal.z[0])))
    J = dense(problem.objective.misfit_at, found.normal.z[0])
    slope = np.abs(J.T @ misfit) / (np.linalg.norm(J, axis=0) * np.linalg.norm(misfit))
    assert slope.max() < 1e-6


def test_a_kept_prediction_is_that_of_its_parameters_and_problem(problem):
    """`predict` keeps the outputs of the last x: of no other x, and not of a problem with another model or other data."""
    x = problem.space.vector(problem.model)
    simulated = lambda of, at: [np.asarray(row) for row in np.asarray(of.objective.predict(jnp.asarray(at)))]
    for at in (x, x, x + 0.01, x):
        for row, expected in zip(problem.predict(at), simulated(problem, at), strict=True):
            np.testing.assert_allclose(row, expected[: row.size], rtol=1e-12)
            assert not row.flags.writeable
    shifted = Problem(problem.model, problem.data.map(lambda record: record.replace(u=1.5 * record.u)))
    assert not np.allclose(shifted.predict(x)[0], problem.predict(x)[0])
    assert problem.reweighted([record.weight for record in problem.data]).predict(x)[0] is not problem.predict(x)[0]
