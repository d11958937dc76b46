"""A first fit in a process: few compiled programs, small imports, the flag of XLA set in time; and the starting points behind it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import qmc

import hystfit as hf
from hystfit.config import set_compiler_flags
from hystfit.data.dataset import Dataset
from hystfit.fitting.comparison.candidate_fits import CandidateFits
from hystfit.fitting.comparison.contender import Candidate
from hystfit.fitting.comparison.standings import Standings
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import started_problem
from hystfit.fitting.solvers.lanes import Stack, descend_lanes
from hystfit.fitting.solvers.least_squares import LeastSquares
from hystfit.inference.problem import Problem
from hystfit.models.registry import make_model
from hystfit.models.shared import starting
from hystfit.params.hypercube import latin_hypercube

_PROGRAMS = """
import os, sys
import numpy as np, jax
jax.config.update("jax_enable_x64", True)
compiled = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _, **more: compiled.append(more.get("fun_name")) if "backend_compile" in event else None)
import hystfit as hf
u = 4 * np.sin(np.linspace(0, 20, 3000)) * np.linspace(0.4, 1, 3000)
y = 1.2 * u + np.sin(np.linspace(-0.3, 19.7, 3000)) + 0.01 * np.random.default_rng(0).normal(size=3000)
result = hf.fit("bouc-wen", hf.Record(u, y))
result.predict(result.data[0])
print("small_while_loop" in os.environ.get("XLA_FLAGS", ""))
print(len(compiled), *{"scipy.stats", "scipy.optimize", "optimistix"} & set(sys.modules), sep=",")
from hystfit.models.registry import make_model
u, dt = np.sin(np.arange(300.0)), np.full(300, 0.1)
for name in ("linear+springpot", "lag+preisach", "bouc-wen+relaxation"):
    jax.clear_caches()
    model = make_model(name)
    for call in (lambda: model.free_run(u, dt), lambda: model.design_matrix(u, dt), lambda: model.slope_range(-1, 1, 0.1)):
        compiled.clear()
        call()
        print(len(compiled))
"""
_FLAG = """
import os, jax
jax.config.update("jax_enable_x64", True)
import hystfit as hf
hf.enable_x64(whole_loops=False)
hf.BoucWen()
print("small_while_loop" in os.environ.get("XLA_FLAGS", ""))
"""


def _run(code):
    cleared = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    finished = subprocess.run([sys.executable, "-c", code], env=cleared, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout.strip()


@pytest.fixture(scope="module")
def printed():
    """What a first fit in a process prints, and the programs of operations on the host after it."""
    return _run(_PROGRAMS).splitlines()


def test_a_first_fit_compiles_few_programs_and_imports_no_solver_that_it_does_not_use(printed):
    count, *imported = printed[1].split(",")
    assert int(count) <= 8
    assert "optimistix" not in imported
    assert "scipy.stats" not in imported


def test_operations_on_the_host_are_no_programs_of_their_own(printed):
    """Each took 10 ms of every first fit, kept or not: 40 of the 67 programs of a sweep, a seventh of the processor time of its fit."""
    assert len(printed) == 11
    assert all(int(count) <= 3 for count in printed[2:])


def test_scan_loops_are_compiled_whole_however_double_precision_is_switched_on(printed, monkeypatch):
    assert printed[0] == "True"
    assert _run(_FLAG) == "False"
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    set_compiler_flags()
    assert os.environ["XLA_FLAGS"] == "--xla_cpu_enable_fast_math=false"


def test_a_compiler_of_another_version_gets_no_flag_that_would_end_the_process(monkeypatch):
    monkeypatch.setattr("jaxlib.version.__version__", "0.12.0")
    monkeypatch.setenv("XLA_FLAGS", "")
    set_compiler_flags()
    assert "fusion_emitters" not in os.environ["XLA_FLAGS"]
    assert "small_while_loop" in os.environ["XLA_FLAGS"]


def test_a_first_look_at_a_model_that_does_not_converge_is_short_and_about_as_good():
    """The relaxation of a loop without one drifts: a whole fit spends hundreds of evaluations on it."""
    u = np.sin(np.linspace(0, 20, 300)) * np.linspace(0.4, 1.0, 300)
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.8, mu=0.3, tau=0.4, rho=0.2), u)[0])
    record = hf.Record(u, y + 0.01 * np.random.default_rng(0).normal(size=300), 0.01 * np.arange(300))
    problem, points = started_problem(make_model("bouc-wen+relaxation"), Dataset((record,)))
    start = np.asarray(problem.space.unconstrained(problem.space.vector(points[0])))[None]
    whole, look = (estimator.estimate(problem, start) for estimator in (LeastSquares(), LeastSquares().quick()))
    assert look.evaluations < 0.5 * whole.evaluations
    assert whole.cost * (1 - 1e-6) < look.cost < 1.01 * whole.cost
    error = float(np.sqrt(2 * look.cost / 300) * problem.scales.y)
    near, far = (LeastSquares().quick().up_to(share * error).estimate(problem, start) for share in (0.6, 0.4))
    assert near.evaluations == look.evaluations
    assert far.evaluations <= 0.5 * look.evaluations
    assert look.cost * (1 - 1e-6) < far.cost < 1.1 * look.cost


def test_the_error_of_a_first_look_is_that_of_all_samples():
    """It is fitted to fewer, of which those of the steady period before the record do not count."""
    u = np.sin(2 * np.pi * np.arange(9000) / 3000)
    y = np.asarray(hf.simulate(hf.BoucWen(), u)[0])[3000:]
    record = hf.Record(u[3000:], y + 0.02 * np.random.default_rng(0).normal(size=6000))
    problem, points = started_problem(make_model("bouc-wen"), Dataset((record,)))
    assert len(problem.data[0]) > len(record)
    start = np.asarray(problem.space.unconstrained(problem.space.vector(points[0])))[None]
    look = LeastSquares().quick().estimate(problem, start)
    assert look.cost == pytest.approx(0.5 * np.sum(problem.misfit(look.x) ** 2), rel=0.2)


def test_a_fit_that_cannot_win_ends_before_the_derivatives_on_all_samples(monkeypatch):
    """Their program takes far longer to compile than a simulation."""
    u = 50 * (1 + np.sin(np.linspace(0, 40, 6000)))
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.15, mu=0.4, tau=0.03, rho=0.4), u)[0])
    noise = 0.01 * np.ptp(y)
    record = hf.Record(u, y + noise * np.random.default_rng(0).normal(size=6000))
    problem, points = started_problem(make_model("bouc-wen"), Dataset((record,)))
    start = np.asarray(problem.space.unconstrained(problem.space.vector(points[0])))[None]
    assert LeastSquares().up_to(1.1 * noise).estimate(problem, start).converged
    monkeypatch.setattr(Problem, "linearization", None)
    found = LeastSquares().up_to(0.9 * noise).estimate(problem, start)
    assert not found.converged
    assert problem.error_where_held_out(problem.misfit(found.x)) == pytest.approx(noise, rel=0.05)


def test_a_fit_starts_from_what_its_first_look_started_from(monkeypatch):
    """Starting values of a damper take longer than its fit."""
    u = np.sin(np.linspace(0, 30, 600)) * np.linspace(0.4, 1.0, 600)
    y = u + 0.3 * np.tanh(10 * np.gradient(u)) + 0.01 * np.random.default_rng(0).normal(size=600)
    data, begun, start = Dataset((hf.Record(u, y, 0.01 * np.arange(600)),)), [], hf.Damper.start
    monkeypatch.setattr(hf.Damper, "start", lambda model, records: begun.append(model) or start(model, records))
    fits = CandidateFits(data, "auto", FitOptions(), {}, Standings(data, "prediction", all_validated=False))
    one, quiet = Candidate("damper"), lambda _: None
    fits.first(one, quiet)
    fits.fit(one, quiet)
    assert len(begun) == 1
    assert one.solved is not None
    np.testing.assert_allclose(one.solved.estimate.x, hf.fit("damper", data).x, rtol=1e-9)


def test_records_of_similar_length_share_the_program_of_a_grid(monkeypatch):
    """A program of each length took longer than the fit, and all of them stayed in memory."""
    shapes, run = set(), starting.simulated_grid
    monkeypatch.setattr(starting, "simulated_grid", lambda *of, shapes=shapes: shapes.add(of[3].shape) or run(*of))
    grid = np.array([[0.3], [0.5]])
    for count in (329, 332):
        u = np.sin(np.linspace(0, 20, count))
        record = hf.Record(u=u, y=u, weight=(np.arange(count) > 4).astype(float))
        columns = starting.grid_columns(hf.BoucWen(), {"mu": grid[:, 0]}, [record])
        for column, (mu,) in zip(columns.T, grid, strict=True):
            np.testing.assert_allclose(column, hf.simulate(hf.BoucWen(mu=mu), u)[0][5:], rtol=1e-12, atol=1e-14)
    assert len(shapes) == 1


def test_the_hypercube_is_that_of_scipy():
    for dimensions, count, seed in ((5, 7, 0), (9, 128, 3)):
        expected = qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(count)
        np.testing.assert_array_equal(latin_hypercube(dimensions, count, seed), expected)


def test_descents_side_by_side_end_where_each_ends_alone_and_at_the_minimum_of_scipy():
    u = 4 * np.sin(np.linspace(0, 20, 400)) * np.linspace(0.4, 1, 400)
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.4, tau=0.5, rho=0.5), u)[0])
    y = y + 0.01 * np.random.default_rng(0).normal(size=400)
    problem = hf.Problem(hf.BoucWen(c=1.1, mu=0.5, tau=0.7, rho=0.3), hf.Record(u, y))
    z = problem.space.unconstrained(problem.space.vector(problem.model))
    starts = z + 0.2 * np.random.default_rng(1).normal(size=(10, z.size))  # more than one program has room for
    stack, of = Stack.of([problem.objective]), np.zeros(10, int)
    together = descend_lanes(stack, of, starts, gain=1e-12, steps=60)
    assert (together.converged != together.beaten).all()
    alone = [descend_lanes(stack, of[:1], start[None], gain=1e-12, steps=60) for start in starts]
    least = together.normal.cost[together.converged].min()
    for number, each in enumerate(alone):
        assert each.converged[0]
        if together.converged[number]:
            np.testing.assert_array_equal(together.normal.z[number], each.normal.z[0])
        else:  # others came to as low a cost first
            assert each.normal.cost[0] > (1 - 1e-4) * least
            assert together.steps[number] < each.steps[0]
    oracle = hf.fit(problem.model, hf.Record(u, y), method="trf", starts=1)
    best = problem.space.physical(together.normal.z[np.argmin(together.normal.cost)])
    np.testing.assert_allclose(best, oracle.x, rtol=1e-5, atol=1e-7)


def test_a_descent_from_a_simulation_that_is_not_finite_does_not_converge():
    u = np.sin(np.linspace(0, 20, 100))
    problem = hf.Problem(hf.BoucWen(), hf.Record(u, u + 0.1 * np.sign(np.cos(np.linspace(0, 20, 100)))))
    far = np.full((1, len(problem.space)), 600.0)
    ended = descend_lanes(Stack.of([problem.objective]), np.zeros(1, int), far, gain=1e-12, steps=10)
    assert not ended.converged[0]
    assert ended.normal.cost[0] > 1
