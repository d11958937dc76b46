"""Cholesky factors without copies, against NumPy's."""

import numpy as np
import pytest

from hystfit.models.shared.cholesky import cholesky


def _matrix(size: int) -> np.ndarray:
    rows = np.random.default_rng(size).normal(size=(size + 5, size))
    return rows.T @ rows


@pytest.mark.parametrize("size", [0, 1, 3, 150])
def test_the_factor_is_that_of_numpy(size: int) -> None:
    A = _matrix(size)
    before = A.copy()
    np.testing.assert_allclose(np.tril(cholesky(A)), np.linalg.cholesky(A), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(A, before)


def test_the_factor_may_take_the_memory_of_its_matrix() -> None:
    A = _matrix(20)
    expected = np.linalg.cholesky(A)
    factor = cholesky(A, overwrite=True)
    assert np.shares_memory(factor, A)
    np.testing.assert_allclose(np.tril(factor), expected, rtol=1e-12)


def test_part_of_a_matrix_stays_as_it_is() -> None:
    A = _matrix(20)
    part, before = A[:-1, :-1], A.copy()
    np.testing.assert_allclose(np.tril(cholesky(part, overwrite=True)), np.linalg.cholesky(part), rtol=1e-12)
    np.testing.assert_array_equal(A, before)


def test_matrices_that_are_not_positive_definite_are_refused() -> None:
    for A in (-np.eye(3), np.ones((4, 4)) - np.eye(4)):
        with pytest.raises(np.linalg.LinAlgError):
            cholesky(A)
