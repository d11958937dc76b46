"""Long records in blocks: the numbers of plain linear algebra, within the memory of a block."""

from __future__ import annotations

import dataclasses
import tracemalloc
from typing import Any

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.fit_setup import solve
from hystfit.fitting.judgment.covariance import RANK, _spectrum, _wide_axes, uncertainty
from hystfit.fitting.judgment.near_bounds import Information, centered, centered_lengths
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge
from hystfit.inference import blocks, objective
from hystfit.inference import problem as inference_problem
from hystfit.inference.linearization import Linearization
from hystfit.models.preisach import smooth_system
from hystfit.params.relative_size import OPEN

T = np.arange(3000) / 500
U = 20 * (1 - np.cos(2 * np.pi * T)) * (0.4 + 0.1 * T)


@pytest.fixture(params=[64, 700, 40_000])
def small(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Blocks far smaller than the matrices of these tests."""
    monkeypatch.setattr(blocks, "NUMBERS", request.param)
    return request.param


def matrix(n: int, p: int) -> np.ndarray:
    """Columns of very different sizes, one of them zero."""
    columns = np.random.default_rng(0).normal(size=(n, p)) * np.geomspace(1e-6, 1e6, p)
    columns[:, p // 2] = 0.0
    return columns


@pytest.mark.parametrize("shape", [(1000, 6), (100, 7), (33, 30), (5, 9)])
def test_factors_are_those_of_the_whole(shape: tuple[int, int], small: int) -> None:
    rows = matrix(*shape)
    size = np.linalg.norm(rows, axis=0) + (np.linalg.norm(rows, axis=0) == 0)
    Q, R = blocks.qr(rows.copy(), overwrite=True)
    np.testing.assert_array_equal(Q, blocks.qr(rows)[0])
    np.testing.assert_allclose(Q.T @ Q, np.eye(min(shape)), atol=1e-12)
    np.testing.assert_allclose(Q @ (R / size), rows / size, atol=1e-12)


def test_sums_are_those_of_the_whole(small: int) -> None:
    rows = np.asfortranarray(matrix(1000, 6))
    np.testing.assert_allclose(blocks.spread(rows), rows.std(axis=0), rtol=1e-12)
    widths: list[int] = []

    def doubled(part: np.ndarray) -> np.ndarray:
        assert part.flags.f_contiguous
        widths.append(part.shape[1])
        return 2.0 * part

    found = blocks.gram([rows[:, :2], rows[:, 2], rows[:, 3:]], doubled)
    np.testing.assert_allclose(found, 2 * rows.T @ rows, rtol=1e-9, atol=1e-9)
    assert max(widths) * 1000 <= max(small, 1000)
    assert all((part.stop - part.start) * 6 <= max(small, 6) for part in blocks.parts(1000, 6))


def loop() -> hf.Record:
    """Plays with slow noise, and with a model error."""
    rng = np.random.default_rng(3)
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.2, mu=0.5, tau=0.05, rho=0.4), U)[0])
    return hf.Record(u=U, y=y + 0.02 * rng.normal(size=U.size), t=T)


def fitted() -> dict[str, Any]:
    """A default fit of plays: values, errors, noise."""
    result = hf.fit(hf.PrandtlIshlinskii.of(6), loop(), starts=1)
    return {p.name: (p.value, p.stderr) for p in result.parameters} | {"status": str(result.status)}


def test_a_fit_in_blocks_is_the_fit_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, shapes = fitted(), []
    monkeypatch.setattr(blocks, "NUMBERS", 10_000)
    monkeypatch.setattr(
        inference_problem, "COLUMNS", 0
    )  # too large for a design matrix: derivatives by scans of the samples
    compute = objective._linearize

    def watched(*given: Any) -> Any:
        shapes.append(given[0].batch.u.size * len(given[2]))
        return compute(*given)

    monkeypatch.setattr(objective, "_linearize", watched)
    parted = fitted()
    assert max(shapes) <= 10_000 < 8 * max(shapes)
    assert parted.pop("status") == whole.pop("status")
    for name, pair in whole.items():
        assert (pair[1] is None) == (parted[name][1] is None)
        got, expected = (np.array(values, dtype=float) for values in (parted[name], pair))
        np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-9, equal_nan=True)


def test_the_weights_need_their_columns_and_a_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays of NumPy: the design matrix, its columns for the solve, and a block; scaled and centered ones would be seven times as much."""
    monkeypatch.setattr(blocks, "NUMBERS", 10_000)
    t = np.arange(20_000) / 500
    record = hf.Record(u=20 * (1 - np.cos(2 * np.pi * t)), y=t, t=t)
    problem = hf.Problem(hf.PrandtlIshlinskii.of(20).start([record]), record)
    x = problem.space.vector(problem.model)
    fit_ridge(LinearSystem.of(problem, x))
    tracemalloc.start()
    fit_ridge(LinearSystem.of(problem, x))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.3 * problem.objective.batch.u.size * len(problem.space) * 8


@pytest.mark.parametrize("rows", [1, 7, 200])
def test_the_factor_of_blocks_is_that_of_all_rows(rows: int) -> None:
    whole = matrix(100, 9)
    parts = (whole[start : start + rows] for start in range(0, 100, rows))
    factor = blocks.triangle(parts, 9)
    np.testing.assert_array_equal(factor, np.triu(factor))
    size = np.linalg.norm(whole, axis=0) + (np.linalg.norm(whole, axis=0) == 0)
    np.testing.assert_allclose((factor / size).T @ (factor / size), (whole / size).T @ (whole / size), atol=1e-12)


def test_lengths_of_centered_columns_need_no_whole_matrix(small: int) -> None:
    """Offsets of three records, a column that they explain and others far from zero."""
    record = np.repeat(np.eye(3), [200, 300, 500], axis=0) * np.linspace(1, 2, 1000)[:, None]
    columns = np.column_stack([record, record @ [1.0, 2.0, 3.0], matrix(1000, 6) + 1e3])
    offsets = np.arange(columns.shape[1]) < 3
    linear = Linearization.of(np.ones(1000), columns, np.ones(1000, bool))
    expected = np.linalg.norm(centered(columns, offsets)[0], axis=0)
    np.testing.assert_allclose(centered_lengths(linear, offsets), expected, rtol=1e-9)


@pytest.mark.parametrize("kind", [hf.Preisach, hf.SignedPreisach])
def test_errors_from_the_normal_equations_are_those_from_the_samples(kind: type[hf.Preisach]) -> None:
    """Two records with offsets of their own, one with weights of which some are zero."""
    u = hf.signals.random_reversals(duration=60, rate=20, speed=1.0, seed=2)[1]
    y = np.tanh(2 * u) + np.cumsum(np.clip(np.diff(u, prepend=0), -0.1, 0.1)) / 5
    y += 0.01 * np.random.default_rng(0).normal(size=u.size)
    first = hf.Record(u[:600], y[:600], name="first")
    second = hf.Record(u[600:], y[600:] + 0.3, name="second", weight=np.arange(600) % 3)
    problem = hf.Problem(kind.of(12).start([first, second]), hf.Dataset((first, second)))
    estimate = solve(problem, "preisach", 1, 0)
    assert estimate.linearized is not None
    fast, slow = (uncertainty(problem, e) for e in (estimate, dataclasses.replace(estimate, linearized=None)))
    assert (fast.rank, fast.determined.tolist()) == (slow.rank, slow.determined.tolist())
    np.testing.assert_allclose(fast.joint, slow.joint, rtol=1e-6, atol=1e-9 * np.nanmax(slow.joint))
    np.testing.assert_allclose(estimate.linearized.gradient(), problem.linearization(estimate.x).gradient(), atol=1e-9)


@pytest.mark.parametrize("rank", [0, 1, 7, 30])
def test_the_root_of_a_normal_matrix_of_any_rank_has_the_singular_values_of_the_columns(rank: int) -> None:
    rng = np.random.default_rng(rank)
    columns = rng.normal(size=(60, rank)) @ rng.normal(size=(rank, 30)) * np.geomspace(1e-4, 1e4, 30)
    columns[:, 3] = 0.0
    root = blocks.gram_root(columns.T @ columns)
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    np.testing.assert_allclose(
        root.T @ root / size / size[:, None], columns.T @ columns / size / size[:, None], atol=1e-13
    )
    expected = np.linalg.svd(columns / size, compute_uv=False)
    np.testing.assert_allclose(np.linalg.svd(root / size, compute_uv=False), expected, atol=1e-7)


def test_the_spectrum_of_many_columns_is_that_of_their_singular_values() -> None:
    rows = np.random.default_rng(0).normal(size=(300, 100)) * np.geomspace(1e-3, 1e3, 100)
    rows[:, 1] = 2 * rows[:, 0]
    information = Information(rows, 4.0, np.zeros((100, 100)))
    values, root, back = _spectrum(information, np.ones(100, bool), np.zeros(100, bool))
    expected = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)
    np.testing.assert_allclose(values[:-1], expected[:-1], rtol=1e-9)
    assert values[-1] < RANK * values[0]
    known = (back @ root)[:, values > RANK * values[0]]
    others = np.delete(
        rows, 1, axis=1
    )  # twice the first column: a third parameter leaves the errors of all but these two
    expected = 4.0 * np.linalg.inv(others.T @ others)
    np.testing.assert_allclose((known @ known.T)[2:, 2:], expected[1:, 1:], rtol=1e-6, atol=1e-12)


def test_errors_of_many_columns_are_those_of_the_inverse_where_all_are_known() -> None:
    """Also with the offset of a record among them, about which the others are centered."""
    rows = np.random.default_rng(0).normal(size=(300, 100)) * np.geomspace(1e-3, 1e3, 100)
    rows[:, 7] = 1.0
    offsets = np.arange(100) == 7
    values, root, back = _spectrum(Information(rows, 4.0, np.zeros((100, 100))), np.ones(100, bool), offsets)
    expected = np.linalg.svd(centered(rows, offsets)[0] / np.linalg.norm(centered(rows, offsets)[0], axis=0))[1]
    np.testing.assert_allclose(values, expected[[0, -1]], rtol=1e-9)
    np.testing.assert_allclose(back @ root @ root.T @ back.T, 4.0 * np.linalg.inv(rows.T @ rows), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("held", [False, True])
def test_errors_of_many_columns_under_a_penalty_are_those_of_the_normal_matrix_with_it(held: bool) -> None:
    """Offsets of two records, without a penalty or with one; the first and only column of the second explains another."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(300, 100)) + 1.0
    root = np.diag(np.geomspace(0.1, 10.0, 100)) + np.diag(-np.geomspace(0.1, 9.0, 99), 1)  # differences of neighbors
    rows[:, 7], rows[:, 8] = np.arange(300) < 120, np.arange(300) >= 120
    rows[:, 9] = 3.0 * rows[:, 8]
    offsets = np.isin(np.arange(100), (7, 8))
    root[:, offsets] *= 0.1 * held
    penalty = root.T @ root
    stacked = centered(np.vstack([rows, root]), offsets)[0]
    values, root, back = _spectrum(Information(rows, 4.0, penalty), np.ones(100, bool), offsets)
    expected = np.linalg.svd(stacked / np.linalg.norm(stacked, axis=0), compute_uv=False)
    np.testing.assert_allclose(values, expected[[0, -1]], rtol=1e-9)
    inverse = 4.0 * np.linalg.inv(rows.T @ rows + penalty)
    np.testing.assert_allclose(back @ root @ root.T @ back.T, inverse, rtol=1e-6, atol=1e-9)


def test_wide_axes_are_the_directions_of_variances_above_the_size_of_a_parameter() -> None:
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(60, 60)))[0]
    deviations = np.geomspace(1e-3, 0.99, 60) * OPEN
    assert _wide_axes(axes * deviations)[0].size == 0
    deviations[-2:] = 3 * OPEN, 5 * OPEN
    variances, wide = _wide_axes(axes * deviations)
    np.testing.assert_allclose(variances, deviations[-2:] ** 2)
    np.testing.assert_allclose(np.abs(np.sum(wide * axes[:, -2:], axis=0)), 1.0)


def test_errors_of_many_weights_never_hold_the_whole_jacobian(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reversal curves: the design matrices of all curves, their rows, and copies of the Jacobian were ten times as much."""
    for module, name in ((blocks, "NUMBERS"), (smooth_system, "NUMBERS")):
        monkeypatch.setattr(module, name, 20_000)
    truth, curves = hf.Preisach.of(8, initial="positive", spacing="uniform"), []
    truth = truth.start([hf.Record(u=np.array([-1.0, 1.0]), y=np.array([-1.0, 1.0]))])
    for reversal in np.linspace(0.9, -0.95, 40):
        u = np.linspace(reversal, 1.0, 250)
        curves.append(
            hf.Record(u=u, y=truth.free_run(np.append(1.0, u))[1:] + 1e-3 * np.cos(40 * u), name=f"{reversal:.3f}")
        )
    data = hf.Dataset(tuple(curves))
    problem = hf.Problem(hf.SignedPreisach.of(13, spacing="reversal-curves").start(curves), data)
    whole = 8 * sum(map(len, curves)) * len(problem.space)

    def errors() -> None:
        uncertainty(problem, solve(problem, "preisach", 1, 0))

    errors()
    tracemalloc.start()
    errors()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(problem.space) > 100
    assert peak < whole
