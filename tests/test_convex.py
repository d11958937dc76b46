"""The convex solve against scipy, the ridge's choice, and the search for structure on records whose terms are known."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from jaxtyping import Array, Float

import hystfit as hf
from hystfit.errors import ModelError
from hystfit.fitting.comparison.candidate_fits import CandidateFits
from hystfit.fitting.comparison.compare import SEARCH
from hystfit.fitting.comparison.contender import Candidate
from hystfit.fitting.comparison.standings import Standings
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.solvers.convex import Convex
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge, solve_normal
from hystfit.fitting.solvers.variable_projection import Eliminated, Searched, search_nonlinear
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.models.shared import nonnegative
from hystfit.models.shared.design import effective_number
from hystfit.models.shared.nonnegative import solve_nonnegative, solve_several
from hystfit.outcome import Code

T = np.arange(0.0, 12.0, 0.01)
U = 5 + 4 * (0.3 + 0.7 * np.abs(np.sin(2 * np.pi * T / 12))) * np.sin(2 * np.pi * 0.7 * T)


def plays_by_hand(x, widths):
    """Plays at rest on zero, one loop."""
    p, rows = np.zeros(len(widths)), []
    for value in x:
        p = np.maximum(value - widths, np.minimum(value + widths, p))
        rows.append(p)
    return np.array(rows)


@pytest.mark.parametrize("seed", range(5))
def test_solution_equals_bounded_least_squares(seed):
    rng = np.random.default_rng(seed)
    A, w = rng.normal(size=(60, 8)), rng.normal(size=8)
    y = A @ w + 0.1 * rng.normal(size=60)
    free = np.arange(8) < 3
    ridge = np.where(free, 0.0, 0.3)
    several = np.array([A.T @ y, -A.T @ y])
    (found, _), (positive, _) = solve_normal(A.T @ A, several, free, np.array([ridge, ridge]))
    again = solve_normal(A.T @ A, several, free, np.array([ridge, ridge]), rng.random((2, 8)) < 0.5)[0][0]
    assert again == pytest.approx(found, abs=1e-12)  # wherever the search begins
    assert np.array_equal(positive, free | (found > 0))
    stacked = np.vstack([A, np.diag(np.sqrt(ridge))])
    oracle = scipy.optimize.lsq_linear(
        stacked, np.append(y, np.zeros(8)), (np.where(free, -np.inf, 0), np.full(8, np.inf)), tol=1e-14
    ).x
    assert found == pytest.approx(oracle, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_nearly_equal_columns_are_solved_by_their_ridge(seed):
    rng = np.random.default_rng(seed)
    base = rng.normal(size=(200, 6))
    A = np.hstack([base, base + 1e-8 * rng.normal(size=base.shape)])
    y = A @ rng.normal(size=12) + 0.1 * rng.normal(size=200)
    free = np.arange(12) % 3 == 0
    found = solve_normal(A.T @ A, (y @ A)[None], free, np.full((1, 12), 1e-6))[0][0]
    stacked, target = np.vstack([A, 1e-3 * np.eye(12)]), np.append(y, np.zeros(12))
    oracle = scipy.optimize.lsq_linear(stacked, target, (np.where(free, -np.inf, 0), np.full(12, np.inf)), tol=1e-14).x
    assert (found[~free] >= 0).all()
    least = np.sum((target - stacked @ oracle) ** 2)
    assert np.sum((target - stacked @ found) ** 2) == pytest.approx(least, rel=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_singular_normal_equations_have_a_bounded_solution(seed):
    rng = np.random.default_rng(seed)
    M, y = rng.normal(size=(3, 8)), rng.normal(size=3)
    A, bounded = M.T @ M, np.arange(8) > 1
    A -= 1e-14 * np.eye(8)  # what rounding may leave: no longer positive
    w, _ = solve_nonnegative(A, M.T @ y, bounded)
    oracle = scipy.optimize.lsq_linear(M, y, (np.where(bounded, 0, -np.inf), np.full(8, np.inf)), tol=1e-14).x
    assert (w[bounded] >= 0).all()
    assert np.sum((y - M @ w) ** 2) == pytest.approx(np.sum((y - M @ oracle) ** 2), abs=1e-6)


@pytest.mark.parametrize(("seed", "count"), [(40, 60), (97, 60), (5, 200), (8, 200), (3, 300)])
def test_exchanges_of_unknowns_that_go_in_circles_end(seed, count, monkeypatch):
    """Ramps that begin close to each other are nearly collinear, as plays are; no fallback is needed."""
    monkeypatch.setattr(nonnegative, "_by_root", None)
    y, ramps = np.cumsum(np.random.default_rng(seed).normal(size=200)), np.linspace(0, 1, count)
    M = np.maximum(np.linspace(0, 1, 200)[:, None] - ramps, 0)
    A, bounded = M.T @ M, ramps > 0
    A += 1e-9 * np.trace(A) / count * np.eye(count)
    w, _ = solve_nonnegative(A, M.T @ y, bounded)
    root = np.linalg.cholesky(A).T
    oracle = scipy.optimize.lsq_linear(
        root, np.linalg.solve(root.T, M.T @ y), (np.where(bounded, 0, -np.inf), np.inf), tol=1e-14
    ).x
    cost = lambda w: 0.5 * w @ A @ w - w @ M.T @ y
    assert (w[bounded] >= 0).all()
    assert cost(w) <= cost(oracle) + 1e-9 * abs(cost(oracle))


def test_columns_are_the_plays():
    model = hf.PrandtlIshlinskii.of(6).start([hf.Record(u=U, y=U, t=T)])
    record = hf.Record(u=U, y=U, t=T)
    problem = hf.Problem(model, record)
    system = LinearSystem.of(problem, problem.space.vector(model))
    low, high = U.min(), U.max()
    rest = (0.0 - low) / (high - low)
    plays = plays_by_hand((U - low) / (high - low) - rest, np.asarray(model.r)) + rest
    assert system.columns[:, :6] == pytest.approx(plays, abs=1e-12)


def lagging_plays(samples: float) -> hf.Record:
    """Ten plays with falling weights behind a lag of some samples, with noise of 0.1 % of the range."""
    t = 0.01 * np.arange(1000)
    u = 50 + 50 * (1 - 0.09 * t) * np.sin(5.0 * t)
    late = np.asarray(hf.simulate(hf.Lag(tau=0.01 * samples), u, np.full(t.size, 0.01))[0])
    widths = np.linspace(0.4, 41, 10)
    y = 0.2 * late + plays_by_hand(late, widths) @ (0.06 * np.exp(-np.arange(10) / 4))
    return hf.Record(u=u, y=y + 1e-3 * np.ptp(y) * np.random.default_rng(0).normal(size=t.size), t=t)


@pytest.mark.parametrize("samples", [2.3, 3.7])
def test_a_lag_between_half_samples_is_found(samples):
    """A quarter of a sample off, the error is twice the noise, and other terms seem to be needed."""
    record = lagging_plays(samples)
    found = search_structure(hf.Dataset.of(record))
    assert found.structure.rate == 0
    assert found.structure.lag == pytest.approx(samples, abs=0.1)
    assert found.score < 1.15e-3 * np.ptp(record.y)


def test_a_lag_far_from_those_tried_is_found_in_one_step_of_the_trail():
    """The search steps by half a sample from one of the lags that it tries: 24 steps, and as many notes, for one lag of 17 samples."""
    t = 0.5 * np.arange(600)
    u = 50 - 30 * np.cos(2 * np.pi * t / 150) - 12 * (1 - np.cos(2 * np.pi * t / 27))
    late = np.asarray(hf.simulate(hf.Lag(tau=8.5), u, np.full(t.size, 0.5))[0])
    y = np.tanh((late - 40) / 9)
    record = hf.Record(u=u, y=y + 1e-3 * np.ptp(y) * np.random.default_rng(0).normal(size=t.size), t=t)
    found = search_structure(hf.Dataset.of(record))
    assert found.structure.operator == "curve"
    assert found.structure.lag == pytest.approx(17, abs=0.2)
    assert sum(step.startswith("a lag of ") and "order" not in step for step in found.trail) == 1


@pytest.mark.parametrize("samples", [2.3, 3.7])
def test_a_strong_ridge_at_the_start_does_not_hold_a_lag_at_a_wrong_value(samples):
    record = lagging_plays(samples)
    fit = hf.fit("lag+prandtl-ishlinskii:plays=20", record)
    assert fit.train.rmse < 1.2e-3 * np.ptp(record.y)


def test_fit_recovers_weights_on_their_bound():
    rng = np.random.default_rng(0)
    truth = hf.PrandtlIshlinskii.of(8).start([hf.Record(u=U, y=U, t=T)])
    w = jnp.asarray([[0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.5, 0.0]])
    truth = eqx.tree_at(lambda m: m.w, truth, w)
    y = np.asarray(hf.simulate(truth, U)[0])
    result = hf.fit(hf.PrandtlIshlinskii.of(8), hf.Record(u=U, y=y + rng.normal(0, 1e-3, y.size), t=T))
    assert result.method == "convex"
    weights = [result[f"w[0,{j}]"] for j in range(8)]
    found = np.array([weight.value for weight in weights])
    for weight, value in zip(weights, np.asarray(w)[0], strict=True):
        assert abs(weight.value - value) < 4 * (weight.stderr or 1e-12)
    # The same least squares by scipy, with the plays of a plain loop: the record hardly needs regularization.
    low, span = U.min(), np.ptp(U)
    rest = (0.0 - low) / span
    plays = plays_by_hand((U - low) / span - rest, np.asarray(truth.r)) + rest
    columns = np.column_stack([plays, (U - low) / span, np.ones(U.size)])
    lower = np.r_[np.zeros(8), -np.inf, -np.inf]
    oracle = scipy.optimize.lsq_linear(columns, result.data[0].y, (lower, np.inf), tol=1e-14).x[:8]
    assert found == pytest.approx(oracle, abs=2e-3)
    assert [j for j in range(8) if weights[j].at_bound == "lower"] == np.flatnonzero(oracle < 1e-9).tolist() == [3, 7]


def test_left_out_blocks_ask_for_more_ridge_when_there_is_more_noise():
    truth = hf.PrandtlIshlinskii.of(5).start([hf.Record(u=U, y=U, t=T)])
    clean = np.asarray(hf.simulate(truth, U)[0])
    strengths = []
    for noise in (1e-5, 1.0):
        y = clean + np.random.default_rng(1).normal(0, noise, clean.size)
        problem = hf.Problem(
            hf.PrandtlIshlinskii.of(20, 5, envelopes=3).start([hf.Record(u=U, y=y, t=T)]), hf.Record(u=U, y=y, t=T)
        )
        strengths.append(fit_ridge(LinearSystem.of(problem, problem.space.vector(problem.model))).strength)
    assert strengths[0] < strengths[1]


def test_bounds_it_does_not_serve_are_refused():
    class Capped(AbstractHysteresis):
        """A gain that may not exceed 2: linear, with a bound other than zero."""

        rate_independent: ClassVar[bool] = True
        gain: Float[Array, ""] = hf.param(1.0, bounds=(0.0, 2.0), linear=True, doc="slope")

        def init(self, u0):
            return jnp.zeros((0,))

        def step(self, state, u0, u1, dt):
            return state, self.gain * u1

        def start(self, records):
            return self

    with pytest.raises(ModelError, match="linear parameters must be free or >= 0"):
        hf.fit(Capped(), hf.Record(u=U, y=U, t=T), method="convex")


@pytest.mark.slow
def test_search_finds_lag_creep_and_asymmetry():
    """A device with a lag of 30 ms, creep and an asymmetric loop; the search has to ask for these and for no force of the rate."""
    plays = hf.PrandtlIshlinskii.of(10, 1, envelopes=3)
    device = hf.Series(hf.Lag(tau=0.03), hf.Sum(plays, hf.LinearCreep(a=[0.15])))
    device = device.start([hf.Record(u=U, y=U, t=T)])
    device = eqx.tree_at(
        lambda m: (m.parts[0].tau, m.parts[1].parts[1].a), device, (jnp.asarray(0.03), jnp.asarray([0.15]))
    )
    dt = np.full(T.size, 0.01)
    y = np.asarray(hf.simulate(device, U, dt)[0])
    record = hf.Record(u=U, y=y + np.random.default_rng(2).normal(0, 1e-3 * np.ptp(y), y.size), t=T)
    found = search_structure(hf.Dataset.of(record), plays=10)
    assert found.structure.operator == "play"
    assert found.structure.envelopes == 3
    assert found.structure.lag == pytest.approx(3.0, abs=0.5)
    assert found.structure.creep
    assert (found.structure.rate, found.structure.hardening) == (0, 0.0)
    assert found.score < 2.3e-3 * np.ptp(y)


@pytest.mark.slow
def test_compare_prefers_the_model_that_made_the_data():
    u = U - 5
    made = hf.BoucWenForce(kappa_x=0.3, kappa_w=2.0, rho=1.0, sigma=0.8, n=2.0)
    y = np.asarray(hf.simulate(made, u)[0])
    record = hf.Record(u=u, y=y + np.random.default_rng(3).normal(0, 0.02, y.size), t=T)
    comparison = hf.compare(record, ["bouc-wen-force", "duhem", SEARCH])
    assert comparison.rows[0].name == "bouc-wen-force"
    assert comparison.rows[0].score_percent == pytest.approx(100 * 0.02 / np.ptp(record.y), rel=0.1)


def test_compare_refuses_an_unknown_model_before_it_works():
    with pytest.raises(ModelError):
        hf.compare(hf.Record(u=U, y=U, t=T), ["bouc-wen", "buc-wen"])


def test_weights_of_noise_take_the_largest_strength_and_are_not_usable() -> None:
    """Noise that does not follow the input needs no weights: the ridge chosen for them is the largest, and the status says so."""
    record = hf.Record(u=U, y=np.random.default_rng(3).normal(size=U.size), t=T)
    problem = hf.Problem(hf.PrandtlIshlinskii.of(6).start([record]), record)
    convex = Convex(strengths=(1e-3, 1e2))
    found = convex.estimate(problem, problem.space.unconstrained(problem.space.vector(problem.model))[None])
    (note,) = [note for note in found.notes if note.code is Code.CHOICE]
    assert note.text.startswith("ridge 1e+02 ")
    assert not hf.fit(hf.PrandtlIshlinskii.of(6), record).usable


def test_systems_that_are_solved_side_by_side_have_the_solutions_of_an_active_set_method():
    rng = np.random.default_rng(3)
    roots = rng.normal(size=(30, 40, 12)).cumsum(axis=1)
    y = roots @ rng.normal(size=(30, 12, 1)) + rng.normal(size=(30, 40, 1))
    A, b = roots.transpose(0, 2, 1) @ roots, (roots.transpose(0, 2, 1) @ y)[..., 0]
    found, _ = solve_several(A, b, np.ones(12, dtype=bool))
    expected = np.array([scipy.optimize.nnls(root, out[:, 0])[0] for root, out in zip(roots, y, strict=True)])
    assert (expected == 0).any(axis=1).sum() > 20
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)
    half = np.arange(12) < 6
    for w, one, right in zip(solve_several(A, b, half)[0], A, b, strict=True):
        dual = one @ w - right
        assert (w[half] >= 0).all()
        assert (dual[half] > -1e-8 * np.abs(right).max()).all()
        np.testing.assert_allclose(np.where(half & (w == 0), 0.0, dual), 0.0, atol=1e-8 * np.abs(right).max())


def test_the_number_of_determined_weights_is_the_trace_of_the_matrix_that_predicts():
    rng = np.random.default_rng(4)
    X, free = rng.normal(size=(50, 8)), np.arange(8) != 3
    ridge = np.diag(rng.uniform(1, 100, 8))
    used = X[:, free]
    hat = used @ np.linalg.inv(used.T @ used + ridge[np.ix_(free, free)]) @ used.T
    assert effective_number(X.T @ X, ridge, free) == pytest.approx(np.trace(hat), rel=1e-9)


# A relaxation behind plays -------------------------------------------------------------------------------------------------------


def relaxing_plays(*periods: float) -> list[hf.Record]:
    """Plays by hand, whose output follows in part with two time constants, as the solution for an input held over each step."""
    records = []
    for number, period in enumerate(periods):
        dt = period / 200
        u = np.linspace(1.0, 0.4, 600) * np.sin(2 * np.pi * np.arange(600) / 200)
        x = plays_by_hand(u, np.array([0.1, 0.25, 0.5])) @ np.array([0.5, 0.3, 0.4]) + 0.6 * u
        y, lags = x.copy(), np.zeros(2)
        for k in range(600):
            lags += -np.expm1(-dt / np.array([0.3, 6.0])) * (x[k] - lags)
            y[k] -= np.array([0.25, 0.35]) @ (x[k] - lags)
        y += 0.002 * np.random.default_rng(number).normal(size=600)
        records.append(hf.Record(u=u, y=y, t=dt * np.arange(600), name=f"{period:g} s"))
    return records


def test_parts_and_times_of_a_relaxation_behind_plays_are_found() -> None:
    fit = hf.fit("prandtl-ishlinskii+relaxation", relaxing_plays(0.5, 5.0, 50.0))
    assert fit.usable
    found = fit.values
    assert [found["a[0]"], found["a[1]"]] == pytest.approx([0.25, 0.35], abs=0.02)
    assert [found["tau[0]"], found["tau[1]"]] == pytest.approx([0.3, 6.0], rel=0.1)


def test_a_first_fit_finds_a_relaxation_behind_plays() -> None:
    """Or its model is stopped: where the search ended early, its error was 20 times the noise."""
    data = hf.Dataset(tuple(relaxing_plays(0.5, 5.0, 50.0)))
    candidate, standings = (
        Candidate("prandtl-ishlinskii+relaxation"),
        Standings(data, "prediction", all_validated=False),
    )
    CandidateFits(data, "auto", FitOptions(), {}, standings).first(candidate, lambda _: None)
    assert candidate.first is not None
    assert candidate.first.error < 3 * 0.002


@pytest.mark.slow  # 20 models
def test_a_relaxation_behind_plays_wins_the_comparison() -> None:
    """Behind plays, or behind relays with finer thresholds than the 20 plays have, which leave the noise alone."""
    comparison = hf.compare(relaxing_plays(0.5, 5.0, 50.0))
    best = comparison.rows[0]
    assert best.asked.endswith("+relaxation")
    assert best.score < 1.1 * 100 * 0.002 / comparison.winner.baselines.span


def test_a_lag_before_plays_does_not_depend_on_its_starting_value() -> None:
    """The ridge that cross-validation chose at the start decided where the search ended."""
    rng, k, tau, dt = np.random.default_rng(0), np.arange(700), 0.08, 0.01
    u = np.linspace(1.0, 0.4, 700) * np.sin(2 * np.pi * k / 140)
    behind, state = np.empty(700), u[0]
    for sample, value in enumerate(u):
        state += -np.expm1(-dt / tau) * (value - state)
        behind[sample] = state
    y = plays_by_hand(behind, np.array([0.05, 0.17, 0.33])) @ np.array([0.5, 0.3, 0.4]) + 0.3 * np.tanh(2 * behind)
    record = hf.Record(u=u, y=y + 0.03 * rng.normal(size=700), t=dt * k)
    starts = (0.005, 0.03, 0.08, 0.3)
    found = [hf.fit("lag+prandtl-ishlinskii", record, start={"tau": start}).values["tau"] for start in starts]
    assert np.ptp(found) < 2e-4 * tau
    assert found[0] == pytest.approx(tau, rel=0.01)


def _searched(residuals: Callable[[np.ndarray], np.ndarray], start: float, steps: int = 40) -> Searched:
    """A search over the time constant of a lag."""
    u = np.sin(np.arange(100) / 5)
    problem = Problem(make_model("lag+linear"), hf.Dataset.of(hf.Record(u=u, y=u, t=0.1 * np.arange(100))))
    z = problem.space.unconstrained(np.array([start, 1.0]))

    def eliminated(x: np.ndarray) -> Eliminated:
        left = residuals(x[0])
        return Eliminated(left, lambda: ((residuals(x[0] * np.exp(1e-6)) - left) / 1e-6)[:, None])

    return search_nonlinear(problem, eliminated, z, np.array([0]), steps=steps, gain=1e-8)


def test_a_search_ends_where_a_parameter_has_no_effect() -> None:
    assert _searched(lambda _: np.ones(5), 0.3).converged


def test_a_search_turns_back_from_parameters_that_are_not_finite() -> None:
    """And from equations that cannot be solved there."""

    def residuals(tau: float) -> np.ndarray:
        if tau > 0.5:
            raise np.linalg.LinAlgError
        return np.append(10 * (tau - 0.45), np.nan if tau > 0.48 else 0.0)

    found = _searched(residuals, 0.1)
    assert found.converged
    assert found.x[0] == pytest.approx(0.45, rel=1e-3)


def test_a_search_that_is_stopped_has_not_converged() -> None:
    found = _searched(lambda tau: np.array([np.log(tau) ** 2 + 1]), 1e-3, steps=3)
    assert not found.converged
    assert "stopped after" in found.message


def test_a_search_from_parameters_that_are_not_finite_says_so() -> None:
    found = _searched(lambda _: np.full(5, np.nan), 0.3)
    assert not found.converged
    assert "not finite" in found.message
