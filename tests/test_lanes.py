"""The solver of many lanes: its normal equations against finite differences, its descents against scipy, on both kinds of devices."""

import functools
import itertools
import warnings

import jax
import numpy as np
import pytest
import scipy.optimize

import hystfit as hf
from hystfit.config import expect_few_runs, first_device
from hystfit.data.dataset import Dataset
from hystfit.fitting.fit_setup import started_problem
from hystfit.fitting.solvers import lanes
from hystfit.fitting.solvers.lanes import Stack, descend_lanes
from hystfit.fitting.solvers.levenberg_marquardt import between_bounds, to_bounds
from hystfit.fitting.solvers.multistart import starting_vectors
from hystfit.inference.normal import normal_at, normal_in_scan, normal_on_host, suits_one_scan
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.params.coordinates import BOTH

SAMPLES = 150
MODELS = [
    (hf.BoucWen(c=1.1, mu=0.5, tau=2.0, rho=0.4, offset=0.3), "linear"),
    (hf.BoucWenForce(), "huber"),
    (hf.Duhem(alpha=2.0), "soft-l1"),
    (hf.PrandtlIshlinskii.of(3), "linear"),
]


class Side:
    """Stands for a device on which lanes go together."""

    platform = "gpu"


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> Side:
    """Lanes go together, on the CPU of this machine."""
    put = lanes.placed
    monkeypatch.setattr(lanes, "_UNROLL", 1)  # takes less time to compile
    monkeypatch.setattr(lanes, "placed", lambda tree, device: put(tree, first_device("cpu")))
    return Side()


def problem(model: AbstractHysteresis, seed: int, loss: str = "linear", samples: int = SAMPLES) -> Problem:
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * 0.01
    u = np.sin(8 * t + 0.1 * seed) * (0.5 + t)
    y = np.asarray(hf.simulate(model, u, 0.01)[0])
    y = y + 0.01 * np.ptp(y) * rng.normal(size=samples)
    y[20] += 0.5 * np.ptp(y)
    y[40] = np.nan
    weight = np.where(np.arange(samples) < 5, 0.0, rng.uniform(0.5, 2.0, samples))
    return Problem(model, hf.Record(u=u, y=y, t=t, weight=weight), loss=loss)


# A residual of a robust loss and of the plain one, one parameter of each name and several.
QUICK = MODELS[2:]


@pytest.mark.parametrize(
    ("model", "loss"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in MODELS[:2])],
    ids=lambda part: type(part).__name__,
)
def test_normal_equations_are_those_of_finite_differences(model: AbstractHysteresis, loss: str) -> None:
    """All forms, with weights, missing samples and a robust loss."""
    posed = problem(model, 1, loss)
    objective, z = posed.objective, posed.space.unconstrained(posed.space.vector(model)) + 0.05
    misfit = jax.jit(lambda objective, z: objective.misfit_at(z))
    at = lambda z: np.asarray(misfit(objective, z))
    steps = 1e-5 * np.eye(z.size)
    J = np.stack([(at(z + step) - at(z - step)) / 2e-5 for step in steps], axis=1)
    assert suits_one_scan(objective)
    forms = (normal_at, normal_in_scan, functools.partial(normal_in_scan, block=16))
    for found in (normal_on_host(objective, z), *(jax.jit(form)(objective, z) for form in forms)):
        np.testing.assert_allclose(found.cost, 0.5 * at(z) @ at(z), rtol=1e-12)
        size = np.linalg.norm(J, axis=0) + 1e-12
        np.testing.assert_allclose(found.gradient / size, J.T @ at(z) / size, atol=2e-5)
        np.testing.assert_allclose(found.matrix / size / size[:, None], J.T @ J / size / size[:, None], atol=2e-5)


def lanes_of(count: int) -> tuple[list[Problem], Stack, np.ndarray]:
    model = hf.BoucWen(c=1.1, mu=0.5, tau=2.0, rho=0.4, offset=0.3)
    posed = [problem(model, seed) for seed in range(count)]
    rng = np.random.default_rng(0)
    starts = [p.space.unconstrained(p.space.vector(model)) + 0.3 * rng.normal(size=len(p.space)) for p in posed]
    return posed, Stack.of([p.objective for p in posed]), np.stack(starts)


@pytest.mark.parametrize("offsets", [False, True], ids=["one record", "an offset for each of two"])
def test_lanes_of_one_problem_end_alike_by_the_program_of_the_last_steps(offsets: bool, monkeypatch) -> None:
    """Where few runs are expected, a descent compiles no program of its own."""
    model = hf.BoucWen(c=1.1, mu=0.5, tau=2.0, rho=0.4, offset=0.3)
    records = [problem(model, seed).data[0] for seed in range(1 + offsets)]
    posed = Problem(model, [record.replace(name=str(k)) for k, record in enumerate(records)])
    z = posed.space.unconstrained(posed.space.vector(model))
    starts = z + 0.1 * np.random.default_rng(0).normal(size=(3, z.size))
    descend = lambda: descend_lanes(Stack.of([posed.objective]), np.zeros(3, int), starts, gain=1e-6, steps=30)
    expected = descend()
    monkeypatch.setattr(lanes, "_linearized", None)
    with expect_few_runs():
        found = descend()
    np.testing.assert_array_equal(found.steps, expected.steps)
    np.testing.assert_allclose(found.cost, expected.cost, rtol=1e-9)
    np.testing.assert_allclose(found.normal.z, expected.normal.z, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("records", [[0, 0, 1, 2], [4, 5, 5], [5], [1, 1, 4], [3, 0, 0, 4]], ids=str)
def test_the_problems_of_some_records_are_theirs(records: list[int]) -> None:
    """Those side by side are a part of the arrays, at the end one that begins before them; others are copied."""
    posed, stack, _ = lanes_of(6)
    some, place = lanes._of_records(stack, np.array(records), 4)
    assert some.count == min(4, lanes.room(len(set(records))))
    for number, at in zip(records, place, strict=True):
        np.testing.assert_array_equal(some.at(int(at)).batch.y, posed[number].objective.batch.y)


@pytest.mark.parametrize("way", ["one after another", "many on a CPU", "on a GPU"])
def test_lanes_end_where_scipy_does(way: str, together: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    """More lanes than records, in any order; on both kinds of devices."""
    if way == "many on a CPU":
        monkeypatch.setattr(lanes, "_PAYS", 1)
        monkeypatch.setattr(lanes, "BESIDE", 4)
        monkeypatch.setattr(lanes, "_CHUNK", (64, 6))  # the last lanes of a call are linearized twice
    side = way == "on a GPU"
    posed, stack, starts = lanes_of(6)
    records = np.array([5, 0, 2, 0, 1, 3, 0])
    kept = starts.copy()
    ends = descend_lanes(stack, records, starts[records], gain=1e-13, steps=60, device=together if side else None)
    np.testing.assert_array_equal(starts, kept)
    assert ends.converged.all()
    for z, cost, number in zip(ends.normal.z, ends.normal.cost, records, strict=True):
        p = posed[number]
        np.testing.assert_allclose(0.5 * np.sum(p.misfit(p.space.physical(z)) ** 2), cost, rtol=1e-10)
        found = scipy.optimize.least_squares(
            p.misfit, p.space.physical(z) * 1.001, x_scale="jac", xtol=1e-14, ftol=1e-14
        )
        assert cost <= found.cost * (1 + 1e-9)
        error = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * 2 * found.cost / SAMPLES)
        np.testing.assert_allclose((p.space.physical(z) - found.x) / error, 0.0, atol=1e-3)


def test_both_kinds_of_devices_agree_and_converged_lanes_leave(together: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    _, stack, starts = lanes_of(6)
    starts[3] += 3.0
    records, sizes, advanced = np.arange(6), [], lanes._advance_all
    one_by_one = descend_lanes(stack, records, starts, gain=1e-13, steps=60)
    monkeypatch.setattr(lanes, "_ROUND", 2)
    monkeypatch.setattr(lanes, "_advance_all", lambda *a: sizes.append(len(a[1])) or advanced(*a))
    side_by_side = descend_lanes(stack, records, starts, gain=1e-13, steps=60, device=together)
    error = np.sqrt(np.stack([np.diag(np.linalg.inv(m)) for m in one_by_one.normal.matrix]) * 1e-4)
    np.testing.assert_allclose(side_by_side.normal.z / error, one_by_one.normal.z / error, atol=1e-6)
    np.testing.assert_array_equal(side_by_side.converged, one_by_one.converged)
    assert sizes[0] == 8  # with room to the next power of two
    assert sizes[-1] < 8
    assert sizes == sorted(sizes, reverse=True)


def test_a_descent_ends_with_a_step_that_needs_no_look() -> None:
    """From a third of a standard error to within 1e-5 in two linearizations, with the cost and the normal matrix of the minimum."""
    model = hf.BoucWen(c=1.1, mu=0.5, tau=2.0, rho=0.4, offset=0.3)
    t, noise = 0.02 * np.arange(400), np.random.default_rng(0).normal(0, 0.001, (4, 400))
    u = np.sin(8 * t) * (0.5 + 0.1 * t)
    y = np.asarray(hf.simulate(model, u)[0])
    posed = [Problem(model, hf.Record(u=u, y=y + row)) for row in noise]
    stack, records, p = Stack.of([one.objective for one in posed]), np.arange(4), posed[0].space
    start = np.tile(p.unconstrained(p.vector(model)), (4, 1))
    least = descend_lanes(stack, records, start, gain=1e-14, steps=60)
    diagonal = np.linalg.inv(least.normal.matrix).diagonal(axis1=1, axis2=2)
    error = np.sqrt(diagonal * (2 * least.cost / 400)[:, None])
    near = least.normal.z + 0.3 * error
    ends = descend_lanes(stack, records, near, gain=1e-6 / 400, steps=60, damping=np.full(4, 1e-6))
    assert ends.converged.all()
    np.testing.assert_array_equal(ends.steps, 2)
    np.testing.assert_allclose(ends.normal.z / error, least.normal.z / error, atol=1e-5)
    np.testing.assert_allclose(ends.normal.cost, least.normal.cost, rtol=1e-10)
    np.testing.assert_allclose(ends.normal.matrix.diagonal(0, 1, 2), least.normal.matrix.diagonal(0, 1, 2), rtol=1e-3)


def test_descents_go_on_where_they_have_not_ended() -> None:
    """In place, with the end that costs less, and with the steps of both."""
    _, stack, starts = lanes_of(6)
    run = lambda lanes, z, steps: descend_lanes(stack, lanes, z, gain=1e-13, steps=steps)
    ends, whole = run(np.arange(3), starts[:3], 2), run(np.arange(3), starts[:3], 60)
    before = ends.cost.copy()
    assert not ends.converged.any()
    lanes.go_on(ends, np.array([0, 2]), lambda at, z: run(at, z, 60))
    np.testing.assert_array_equal(ends.converged, [True, False, True])
    np.testing.assert_allclose(ends.cost[[0, 2]], whole.cost[[0, 2]], rtol=1e-9)
    assert ends.cost[1] == before[1]
    assert ends.steps[1] == 2
    assert (ends.steps[[0, 2]] > 2).all()
    lanes.go_on(ends, np.array([0]), lambda at, z: pytest.fail("it has converged"))


def test_a_lane_that_cannot_be_simulated_leaves_the_others_unharmed(together: Side) -> None:
    _, stack, starts = lanes_of(6)
    starts[1] = np.nan
    for device in (None, together):
        ends = descend_lanes(stack, np.arange(6), starts, gain=1e-13, steps=60, device=device)
        np.testing.assert_array_equal(ends.converged, np.arange(6) != 1)


def test_a_call_on_a_cpu_holds_few_samples() -> None:
    for samples, many in itertools.product((64, 10_000, 10**7), (False, True)):
        parts = list(lanes._parts(np.arange(500), lanes._chunk(samples, many)))
        np.testing.assert_array_equal(np.concatenate(parts), np.arange(500))
        assert max(map(len, parts)) * samples <= max(samples, 2**20)


def test_a_shortened_step_is_no_sign_of_convergence() -> None:
    """Parameters run away where the model does not describe the data; steps were shortened for them, which promised nothing any more."""
    phase = np.linspace(0, 20, 400)
    u = 4 * np.sin(phase) * np.linspace(0.4, 1, 400)
    y = 1.2 * u + np.sin(phase - 0.3) + 0.01 * np.random.default_rng(0).normal(size=400)
    posed = started_problem(hf.BoucWen(), Dataset((hf.Record(u=u, y=y),)))[0]
    starts = starting_vectors(posed, 8, 0)
    ends = descend_lanes(Stack.of([posed.objective]), np.zeros(8, int), starts, gain=1e-6, steps=25)
    misfit = jax.jit(lambda objective, z: objective.misfit_at(z))
    for z, cost in zip(ends.normal.z[ends.converged], ends.normal.cost[ends.converged], strict=True):
        further = scipy.optimize.least_squares(lambda z: np.asarray(misfit(posed.objective, z)), z, max_nfev=20)
        assert further.cost > 0.99 * cost
    assert ends.normal.cost.min() < 1.1 * min(
        scipy.optimize.least_squares(lambda z: np.asarray(misfit(posed.objective, z)), z, max_nfev=30).cost
        for z in starts[:3]
    )


@pytest.mark.parametrize("seed", [5, 27, 37, 50])
def test_no_step_is_taken_blindly_along_a_direction_that_noise_alone_determines(seed):
    """A line in noise: the model contains lines, so that its fit errs no more than the best of them."""
    phase = np.arange(240) / 240
    u = np.sin(12 * np.pi * phase) * (0.3 + 0.7 * phase)
    y = 3 + 0.01 * u + 0.004 * np.random.default_rng(seed).normal(size=u.size)
    fit = hf.fit(hf.BoucWen(scheme="exact"), hf.Record(u=u, y=y), noise="iid")
    line = y - np.polyval(np.polyfit(u, y, 1), u)
    assert fit.train.rmse < 1.01 * np.sqrt(np.mean(line**2))


@pytest.mark.parametrize("seed", range(3))
def test_a_parameter_at_its_bound_does_not_slow_down_a_descent(seed: int) -> None:
    """A saturating curve without a loop takes the exponents of a loop to a bound, which is at infinity in the coordinates of the steps."""
    t = 0.02 * np.arange(400)
    u = np.sin(8 * t) * (0.5 + 0.1 * t)
    y = np.tanh(2 * u) + 0.3 * u + 0.002 * np.random.default_rng(seed).normal(size=400)
    posed = Problem(hf.BoucWen(c=1.1, mu=0.5, tau=2.0, rho=0.4), hf.Record(u=u, y=y))
    space = posed.space
    x = space.vector(posed.model)
    start = np.array(space.unconstrained(x))[None]
    ends = descend_lanes(Stack.of([posed.objective]), np.zeros(1, int), start, gain=1e-10, steps=300)
    assert ends.steps[0] < 150
    within = scipy.optimize.least_squares(posed.misfit, x, bounds=(space.lower, space.upper), max_nfev=300)
    assert ends.cost[0] < within.cost * (1 + 1e-4)


def test_a_far_bound_is_at_infinity_without_a_warning() -> None:
    """From coordinates at which the nearer of two bounds is reached to all digits."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        low, high = to_bounds(np.array([-800.0, 800.0]), np.array([BOTH, BOTH]), np)
    np.testing.assert_array_equal(low, [-1.0, -np.inf])
    np.testing.assert_array_equal(high, [np.inf, 1.0])


def test_steps_between_bounds_are_the_minimum_there() -> None:
    """By trying which of four parameters are at which bound."""
    rng, alike = np.random.default_rng(0), 0
    for _ in range(200):
        J, r = rng.normal(size=(12, 4)), 3 * rng.normal(size=12)
        low, high = -rng.uniform(0.05, 1.0, 4), rng.uniform(0.05, 1.0, 4)
        low[3], high[3] = -np.inf, np.inf

        def solve(ends: np.ndarray, free: np.ndarray, J: np.ndarray = J, r: np.ndarray = r) -> np.ndarray:
            step = np.where(free, 0.0, ends)
            if free.any():
                step[free] = np.linalg.lstsq(J[:, free], -(r + J @ step))[0]
            return step

        step, ended = between_bounds(solve, lambda step, J=J, r=r: J.T @ (r + J @ step), low, high, np)
        least = scipy.optimize.lsq_linear(J, -r, (low, high), method="bvls")
        if ((step >= low) & (step <= high)).all():
            np.testing.assert_allclose(step, least.x, atol=1e-9)
            np.testing.assert_array_equal(ended, least.active_mask != 0)
            alike += 1
    assert alike > 190
