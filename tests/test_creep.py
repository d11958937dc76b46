"""Creep against the logarithmic law, superposition and plain loops."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hystfit.errors import ModelError
from hystfit.models import LinearCreep, LogCreep, simulate
from hystfit.params import ParameterSpace

GAMMA = 0.0175


def step_response(model: LogCreep, times: np.ndarray, height: float = 12.0) -> np.ndarray:
    """Output at times after a step from rest at zero; the input has its new value from time 0 on."""
    t = np.concatenate([[0.0], times])
    u = np.full(t.size, height)
    u[0] = 0.0
    return np.asarray(simulate(model, u, np.diff(t, prepend=0.0))[0])[1:]


@pytest.mark.parametrize("spread", [400, 37])
def test_the_step_response_is_the_logarithmic_law(spread: int) -> None:
    times = np.geomspace(0.1, 1000.0, spread)
    decades = (step_response(LogCreep(gamma=GAMMA), times) / 12.0 - 1.0) / GAMMA
    np.testing.assert_allclose(decades, np.log10(times / 0.1), atol=2.5e-4)


def test_irregular_and_regular_samples_give_the_same_relaxation() -> None:
    rng = np.random.default_rng(0)
    coarse = np.array([0.5, 3.0, 40.0])
    fine = np.unique(np.concatenate([coarse, rng.uniform(0.0, 40.0, 200)]))
    found = step_response(LogCreep(gamma=GAMMA), fine)[np.searchsorted(fine, coarse)]
    np.testing.assert_allclose(found, step_response(LogCreep(gamma=GAMMA), coarse), rtol=1e-13)


def test_any_input_is_a_sum_of_steps() -> None:
    """y(t) = sum of D_j [1 + gamma log10((t - t_j) / 0.1 s)] over steps D_j at t_j, read where all steps are 0.1 s old."""
    starts, heights = np.array([0.0, 2.0, 7.0, 30.0]), np.array([5.0, -3.0, 4.5, 1.0])
    reads = np.array([1.5, 6.3, 28.0, 300.0])
    t = np.sort(np.concatenate([[0.0], starts, reads]))
    # from a start on the input has its new level; the sample at a start itself still has the old one
    level = np.array([heights[starts < at].sum() for at in t])
    y = np.asarray(simulate(LogCreep(gamma=GAMMA), level, np.diff(t, prepend=0.0))[0])
    for read in reads:
        past = starts < read
        expected = np.sum(heights[past] * (1 + GAMMA * np.log10((read - starts[past]) / 0.1)))
        assert y[np.flatnonzero(t == read)[0]] == pytest.approx(expected, abs=2.5e-4 * GAMMA * np.abs(heights).sum())


def plain(model: LogCreep, u: np.ndarray, dt: np.ndarray) -> list[float]:
    tau, weights, base = (np.asarray(x).tolist() for x in (model.tau, model.weights, model.base))
    rate = lambda x: sum(float(g) * (x / float(model.span)) ** k for k, g in enumerate(model.gamma))
    z = [rate(u[0]) * w * u[0] for w in weights]
    out = []
    for x, h in zip(u, dt, strict=True):
        z = [zi + (1 - math.exp(-h / t)) * (rate(x) * w * x - zi) for zi, t, w in zip(z, tau, weights, strict=True)]
        out.append((1 - rate(x) * base) * x + sum(z))
    return out


def test_simulation_equals_a_plain_loop() -> None:
    rng = np.random.default_rng(1)
    u, dt = rng.uniform(-2.0, 5.0, 40), rng.uniform(0.0, 3.0, 40)
    dt[[0, 11]] = 0.0
    model = LogCreep(gamma=(0.02, -0.01, 0.004), span=5.0)
    np.testing.assert_allclose(simulate(model, u, dt)[0], plain(model, u, dt), rtol=1e-12, atol=1e-12)


def test_an_input_that_rested_for_ever_stays_where_it_is() -> None:
    model = LogCreep(gamma=(0.02, 0.01), span=4.0)
    y = np.asarray(simulate(model, np.full(6, 3.0), np.array([0.0, 0.1, 1.0, 10.0, 1e3, 1e6]))[0])
    rate = 0.02 + 0.01 * 3.0 / 4.0
    decades = float(jnp.sum(model.weights) - model.base)
    np.testing.assert_allclose(y, 3.0 * (1 + rate * decades), rtol=1e-14)


@pytest.mark.parametrize(("shortest", "longest"), [(1e-3, 1.0), (0.05, 3e3), (2.0, 9.0)])
def test_relaxations_spanning_other_times_keep_the_law_per_decade(shortest: float, longest: float) -> None:
    times = np.geomspace(shortest, longest, 101)
    decades = (step_response(LogCreep.spanning(shortest, longest, gamma=GAMMA), times) / 12.0 - 1.0) / GAMMA
    np.testing.assert_allclose(decades, np.log10(times / 0.1), atol=1e-3)


@pytest.mark.parametrize("times", [(0.0, 1.0), (2.0, 1.0), (-1.0, 1.0)])
def test_times_out_of_order_are_refused(times: tuple[float, float]) -> None:
    with pytest.raises(ModelError, match="0 < shortest < longest"):
        LogCreep.spanning(*times)


@pytest.mark.usefixtures("as_users_run")
def test_weights_that_do_not_fit_the_time_constants_are_refused() -> None:
    with pytest.raises(ModelError, match="one weight a time constant"):
        LogCreep(tau=(1.0, 10.0))
    with pytest.raises(ModelError, match="one weight for all or one a time constant"):
        LinearCreep(a=(0.1, 0.2), tau=(1.0, 10.0, 100.0))
    with pytest.raises(ModelError, match="level or first, got 'last'"):
        LinearCreep(rest="last")  # type: ignore[arg-type]


def test_creep_needs_time() -> None:
    with pytest.raises(ModelError, match="LogCreep depends on time: give dt"):
        simulate(LogCreep(), np.ones(3))


# -- linear creep of the input ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rest", ["level", "first"])
def test_linear_creep_is_a_sum_of_exponentials(rest: str) -> None:
    """Closed form for a piecewise constant input: each past level fades with each time constant."""
    rng = np.random.default_rng(2)
    a, tau, low, high, level = np.array([0.3, 0.1, 0.7]), np.array([0.2, 3.0, 50.0]), -2.0, 6.0, 1.0
    u, dt = rng.uniform(-2.0, 6.0, 25), rng.uniform(0.0, 4.0, 25)
    dt[0] = 0.0
    t = np.cumsum(dt)
    x = (u - low) / (high - low)
    rested = x[0] if rest == "first" else (level - low) / (high - low)
    before = np.concatenate([[rested], x[1:-1], x[-1:]])[: x.size]
    before[1:] = x[1:]
    expected = []
    for n in range(x.size):
        jumps = np.diff(np.concatenate([[rested], x[1 : n + 1]]))
        since = t[n] - t[:n]
        expected.append(
            rested * a.sum()
            + sum(np.sum(jumps * ai * (1 - np.exp(-since / ti))) for ai, ti in zip(a, tau, strict=True))
        )
    model = LinearCreep(a=a, tau=tau, low=low, high=high, level=level, rest=rest)  # type: ignore[arg-type]
    np.testing.assert_allclose(simulate(model, u, dt)[0], expected, rtol=1e-12, atol=1e-13)


def test_one_weight_stands_for_all_time_constants() -> None:
    u, dt = np.array([0.0, 1.0, 1.0, 0.5]), np.array([0.0, 1.0, 30.0, 0.2])
    one = simulate(LinearCreep(a=0.2 * np.ones(1)), u, dt)[0]
    each = simulate(LinearCreep(a=np.full(7, 0.2)), u, dt)[0]
    np.testing.assert_allclose(one, each, rtol=1e-14)


def test_the_output_is_linear_where_it_is_declared_to_be() -> None:
    u, dt = np.random.default_rng(3).normal(size=12), np.full(12, 0.3)
    space = ParameterSpace.of(LinearCreep(a=np.linspace(0.1, 0.3, 7)))
    f = lambda x: simulate(space.coordinates.assemble(x), u, dt)[0]
    x = jnp.asarray(space.vector(space.template))
    assert all(info.linear for info in space.infos)
    np.testing.assert_allclose(f(x) - f(0 * x), jax.jvp(f, (5 * x,), (x,))[1], atol=1e-14)
