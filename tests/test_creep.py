"""Creep against the logarithmic law, superposition and plain loops."""

import dataclasses
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hystfit import FitResult, datasets, explain_drift, fit, signals
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.identify import Ukf
from hystfit.inference.problem import Problem
from hystfit.models import AbstractHysteresis, BoucWen, LinearCreep, LogCreep, Series, simulate
from hystfit.outcome import Code
from hystfit.params.space import ParameterSpace
from hystfit.stage import Actuator, Sensor, piezo

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
    with pytest.raises(ModelError, match="weights and tau must have one value for each relaxation"):
        LogCreep(tau=(1.0, 10.0))
    with pytest.raises(ModelError, match="one weight for all or one per time constant"):
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


# -- identified from records -----------------------------------------------------------------------------------------------


def switched_on(seed: int = 0) -> Record:
    """A sine of 0..100 V whose first sample follows a jump from rest at 0 V to 50 V, which the record itself does not hold."""
    t = np.arange(4001) / 100.0
    u = np.where(t > 0, 50.0 + 50.0 * np.sin(2 * np.pi * t), 0.0)
    record = Actuator(model=piezo()).record(t, u, seed=seed)
    return record.segment(1, len(record))


BEGIN = Series(BoucWen(c=0.15, mu=0.4, tau=0.011, rho=0.8, scheme="exact"), LogCreep(gamma=0.01))


@pytest.fixture(scope="module")
def told() -> FitResult:
    """A fit that knows where the device rested before."""
    return fit(BEGIN, switched_on().resting_on(0.0), start="model", starts=1)


def test_drift_is_the_creep_of_the_step_that_began_the_record(told: FitResult) -> None:
    """The mean climbs by gamma times the mean displacement a decade; a fit told of the rest before finds it, one not told cannot."""
    record = switched_on()
    found = explain_drift(told)
    mean = float(np.mean(record.y[-1000:]))
    # the law for a step of the mean, less what the hysteresis settles by: checked to 5 % of the drift
    assert found.measured - found.without_creep == pytest.approx(GAMMA * mean / (1 + 2.6 * GAMMA), rel=0.05)
    assert found.stderr is not None
    assert abs(found.modeled - found.measured) < 3 * found.stderr + 1e-3
    assert abs(found.left) < 0.02 * found.measured
    gamma = told["gamma[0]"]
    assert gamma.stderr is not None
    assert gamma.value == pytest.approx(GAMMA, abs=4 * gamma.stderr)
    assert found.cycles >= 4
    blind = explain_drift(fit(BEGIN, record, start="model", starts=1))
    assert abs(blind.left) > 0.3 * found.measured


def test_drift_that_cannot_be_explained_is_refused_in_words(told: FitResult) -> None:
    short = dataclasses.replace(told, problem=Problem(told.model, told.data[0].segment(0, 250)))
    with pytest.raises(DataError):
        explain_drift(short)
    plain = Problem(BoucWen(), told.data)
    with pytest.raises(ModelError):
        explain_drift(dataclasses.replace(told, problem=plain, x=plain.space.vector(plain.model)))
    with pytest.raises(DataError):
        explain_drift(told, "other")
    with pytest.raises(DataError):
        switched_on().resting_on(np.nan)


def test_a_record_knows_where_the_device_rested() -> None:
    record = switched_on()
    longer = record.window(10.0, 20.0).resting_on(-3.0)
    assert longer.u[0] == -3
    assert np.isnan(longer.y[0])
    np.testing.assert_array_equal(longer.u[1:], record.u)
    np.testing.assert_allclose(np.diff(longer.t)[:3], 0.01, rtol=1e-9)  # type: ignore[arg-type]
    assert longer.used.sum() == 1000
    assert longer.notes[-1].code is Code.PREPARED


@pytest.mark.slow
def test_measured_drift_is_creep(measured: Path) -> None:
    """The piezo's published drift, about 0.42 um a decade, is creep of a step from rest at 0 V, by 1 to 2 % a decade."""
    record = datasets.load("piezo_dbo/model").resting_on(0.0)  # type: ignore[union-attr]
    result = fit("bouc-wen+log-creep", record, starts=1)
    found = explain_drift(result)
    assert found.measured == pytest.approx(0.42, abs=0.03)
    assert found.modeled == pytest.approx(found.measured, abs=0.05)
    assert abs(found.without_creep) < 0.01
    gamma = result["gamma[0]"]
    assert gamma.stderr is not None
    assert 0.01 - 2 * gamma.stderr < gamma.value < 0.02


LEVELS = (20.0, 40.0, 60.0, 80.0, 100.0)


def steps_of(model: AbstractHysteresis, seed: int = 0) -> list[Record]:
    """Steps from rest at 0 V to each level, 100 s, 5 nm of noise."""
    t = np.arange(1001) / 10.0
    u = [np.where(t > 0, level, 0.0) for level in LEVELS]
    actuator = Actuator(model=model, sensor=Sensor(0.005, 0.001))
    return [
        actuator.record(t, v, seed=seed + k, name=f"{level:g} V")
        for k, (v, level) in enumerate(zip(u, LEVELS, strict=True))
    ]


@pytest.mark.slow
def test_creep_that_depends_on_the_level_is_identified_with_the_hysteresis() -> None:
    """A sweep and five steps, one least-squares fit of everything: the truth lies within four standard errors."""
    truth = piezo(gamma=(0.012, 0.006), span=12.0)
    t, u = signals.amplitude_sweep(100.0, cycles=8, low=0.0, high=100.0, anchor="low")
    records = [Actuator(model=truth).record(t, u, seed=9, name="sweep"), *steps_of(truth)]
    begin = Series(BoucWen(c=0.15, mu=0.4, tau=0.011, rho=0.8, scheme="exact"), LogCreep(gamma=(0.01, 0.0), span=12.0))
    found = fit(begin, records, start="model", starts=1, fix=["offset"])
    expected = {"c": 0.1542, "mu": 0.45, "rho": 0.00956 / 0.01086, "gamma[0]": 0.012, "gamma[1]": 0.006}
    for name, value in expected.items():
        parameter = found[name]
        assert parameter.stderr is not None
        assert parameter.value == pytest.approx(value, abs=4 * parameter.stderr), name
        assert parameter.stderr < 0.05 * abs(value), name


def test_the_papers_gamma_of_the_voltage_is_recovered() -> None:
    """Steps of L(t) = L0 [1 + gamma(u) log10(t / 0.1 s)] written down directly, gamma a parabola in the voltage."""
    law = lambda volts: 0.010 + 0.012 * (volts / 100) - 0.004 * (volts / 100) ** 2
    hysteresis = piezo().parts[0]
    rng, t, records = np.random.default_rng(4), np.arange(1001) / 10.0, []
    for level in LEVELS:
        u = np.where(t > 0, level, 0.0)
        first = float(simulate(hysteresis, jnp.asarray([0.0, level]))[0][-1])
        grown = 1 + law(level) * np.log10(np.maximum(t, 0.1) / 0.1)
        y = np.where(t > 0, first * grown, 0.0) + 0.005 * rng.standard_normal(t.size)
        records.append(Record(u=u, y=y, t=t, name=f"{level:g} V"))
    begin = Series(hysteresis, LogCreep(gamma=(0.01, 0.0, 0.0), span=12.0))
    held = ["c", "mu", "bouc_wen.tau", "rho", "offset"]
    found = fit(begin, records, start="model", starts=1, fix=held)
    creep = found.model.parts[1]  # type: ignore[attr-defined]
    for level in LEVELS:
        x = float(simulate(hysteresis, jnp.asarray([0.0, level]))[0][-1])
        gamma = sum(float(g) * (x / 12.0) ** k for k, g in enumerate(creep.gamma))
        # 1000 readings of 5 nm over three decades know 2 um's creep to 0.3 % of its displacement's hundredth
        assert gamma == pytest.approx(law(level), rel=0.02), level
    assert found.train.rmse == pytest.approx(0.005, rel=0.05)


@pytest.mark.slow
def test_the_filter_tracks_creep_that_depends_on_the_level() -> None:
    truth = piezo(gamma=(0.012, 0.006), span=12.0)
    begin = Series(truth.parts[0], LogCreep(gamma=(0.015, 0.0), span=12.0))
    records = steps_of(truth, seed=20)
    ukf = Ukf.of(begin, records, start="model", only=("gamma",), prior=0.3, walk=0.0, hold="none", caution=0.0)
    found = ukf.fit(records)
    creep = found.model.parts[1]  # type: ignore[union-attr]
    for level in (3.0, 12.0):
        expected = 0.012 + 0.006 * level / 12
        assert float(creep.gamma[0] + creep.gamma[1] * level / 12) == pytest.approx(expected, rel=0.05)
