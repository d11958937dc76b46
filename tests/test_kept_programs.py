"""Programs kept between processes: found again, never executed when damaged, never mixed up."""

import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from jax.extend.backend import get_backend

import hystfit as hf
from hystfit.config import PROGRAM_FOLDER, expect_few_runs
from hystfit.fitting.solvers import lanes
from hystfit.fitting.solvers.lanes import Stack
from hystfit.models.shared import simulation
from hystfit.params import kept_programs, program_limit
from hystfit.params.host_arrays import compiled
from hystfit.params.kept_programs import kept, unoptimized
from hystfit.runs.threads import Workers
from hystfit.sampling.truncated_normal import draw_truncated

U, DT = np.sin(np.arange(9.0)), np.ones(9)


class Mine(hf.BoucWen):
    """A class of the user: its source is not part of hystfit."""


def never(*_):
    raise AssertionError("traced without the folder")


def afresh(otherwise=never):
    """The program of `simulate` as a new process finds it."""
    run = kept(simulation._run.__wrapped__, otherwise)
    return lambda model, u=U: np.asarray(run(model, u, DT[: u.size], None)[0])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAM_FOLDER, str(tmp_path / "programs"))
    return tmp_path / "programs"


@pytest.fixture
def only(folder):
    """The file of the one program."""
    afresh()(hf.BoucWen())
    (path,) = folder.iterdir()
    return path


def by_scan(model, u=U):
    return np.asarray(simulation.run(model, jnp.asarray(u), jnp.asarray(DT))[0])


def test_another_process_traces_nothing(only, monkeypatch):
    monkeypatch.setattr(export, "export", never)
    for model in (hf.BoucWen(), hf.BoucWen(mu=0.7, tau=2.0)):
        np.testing.assert_allclose(afresh()(model), by_scan(model), rtol=1e-14)


@pytest.mark.parametrize(
    "damage", [lambda c: b"", lambda c: c[:-1], lambda c: c[:40] + b"\0" + c[41:], lambda c: b"cos\nsystem\n"]
)
def test_a_damaged_file_is_written_again(damage, only, monkeypatch):
    whole = only.read_bytes()
    only.write_bytes(damage(whole))
    opened = []
    deserialize = export.deserialize
    monkeypatch.setattr(export, "deserialize", lambda content: opened.append(content) or deserialize(content))
    np.testing.assert_allclose(afresh()(hf.BoucWen()), by_scan(hf.BoucWen()), rtol=1e-14)
    assert not opened
    afresh()(hf.BoucWen())
    assert len(opened) == 1


def test_the_program_of_all_starts_is_kept(folder):
    """An output that is a named tuple cannot be exported: every process traced and lowered the largest program of a fit again."""
    problem = hf.Problem(hf.BoucWen(), hf.Record(U, U**3))
    stack, z = Stack.of([problem.objective]), problem.space.unconstrained(problem.space.vector(problem.model))
    linearized = kept(lanes._linearized.__wrapped__, never)(stack, np.zeros(2, int), np.stack([z, z]), np.int64(1))
    np.testing.assert_allclose(linearized[1][0], 0.5 * np.sum(np.square(problem.misfit(problem.space.physical(z)))))


def test_a_program_of_random_keys_is_kept(folder, monkeypatch):
    """The dtype of a key is none of NumPy: the sampler of weights stopped at it where programs are kept."""
    w, eye, free = np.ones(2), np.eye(2), np.zeros(2, bool)
    draw = lambda: np.asarray(kept(draw_truncated, never)(jax.random.key(3), w, w, eye, free))
    first = draw()
    np.testing.assert_array_equal(first, draw_truncated(jax.random.key(3), *map(jnp.asarray, (w, w, eye, free))))
    monkeypatch.setattr(export, "export", never)
    np.testing.assert_array_equal(draw(), first)


def test_what_changes_the_trace_changes_the_file(only, folder, monkeypatch):
    run = afresh()
    exact = hf.BoucWen(scheme="exact")
    np.testing.assert_allclose(run(exact), by_scan(exact), rtol=1e-14)
    run(hf.BoucWen(), U[:5])
    assert len(list(folder.iterdir())) == 3
    monkeypatch.setattr(kept_programs, "_setting", lambda: "another version")
    afresh()(hf.BoucWen())
    assert len(list(folder.iterdir())) == 4


def test_classes_of_the_user_are_traced(folder):
    assert afresh(lambda *_: [1.0])(Mine()) == 1.0
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_is_done_without(folder):
    folder.write_text("a file")
    assert afresh(lambda *_: [1.0])(hf.BoucWen()) == 1.0


def test_the_folder_keeps_what_was_used_last(only, folder, monkeypatch):
    monkeypatch.setattr(kept_programs, "_MOST_BYTES", int(1.5 * only.stat().st_size))
    afresh()(hf.BoucWen(scheme="exact"))
    (left,) = folder.iterdir()
    assert left != only


def test_small_programs_of_few_runs_are_compiled_quickly():
    """In the threads of such work too, but neither those of many samples nor of work whose runs take most of the time."""
    few = lambda: unoptimized([np.zeros(100), "predict"])
    assert not few()
    with expect_few_runs():
        assert Workers(2).run([few, few]) == [True, True]
        assert not unoptimized([np.zeros(2**13)])
        with expect_few_runs(long=True):
            assert not few()
    assert not few()


def _doubled(model, x):
    return simulation._run(model, 2 * x, DT, None)[0]


def test_a_program_from_the_folder_that_is_compiled_quickly_computes_the_same(folder):
    with expect_few_runs():
        np.testing.assert_allclose(afresh()(hf.BoucWen()), by_scan(hf.BoucWen()), rtol=1e-14)


def test_a_quickly_compiled_program_computes_the_same_with_another_one_within_it():
    """The one within takes no options of its own."""
    with expect_few_runs():
        np.testing.assert_allclose(compiled(_doubled)(hf.BoucWen(), U), by_scan(hf.BoucWen(), 2 * U), rtol=1e-14)


def test_programs_of_many_lengths_are_dropped_before_they_are_too_many(monkeypatch):
    """As many maps of memory as Linux allows end a process with a segmentation fault; here a program is a map, and eight more the limit."""
    assert (program_limit._MAPS.is_file() and program_limit._MOST.is_file()) == (sys.platform == "linux")
    programs = lambda: len(get_backend().live_executables())
    first = np.asarray(hf.simulate(hf.BoucWen(), U)[0])
    before, most, limit = programs(), 0, (programs() + 8) / program_limit._SHARE
    monkeypatch.setattr(program_limit, "_MAPS", SimpleNamespace(read_bytes=lambda: b"\n" * programs()))
    monkeypatch.setattr(program_limit, "_MOST", SimpleNamespace(read_text=lambda: str(int(limit))))
    monkeypatch.setattr(program_limit, "_EVERY", 2)
    for length in range(20, 60):
        hf.simulate(hf.BoucWen(), np.zeros(length))
        most = max(most, programs())
    assert 4 < most - before < 20
    assert np.asarray(hf.simulate(hf.BoucWen(), U)[0]) == pytest.approx(first, abs=0)
