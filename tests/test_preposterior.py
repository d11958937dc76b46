"""Expected posterior variances of a population beside brute force: further estimates simulated, and the posterior computed again."""

import numpy as np
import pytest

from hystfit.population.hierarchy import Hierarchy
from hystfit.population.next_measurement import Beliefs

MEANS = np.array([0.9, -0.4, 0.35, -0.8, 0.15, 0.6, -1.0, 0.5])
ERRORS = np.array([1.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2])
LOG_SD, MU = np.meshgrid(np.linspace(-4, 2, 121), np.linspace(-2, 2, 121), indexing="ij")
PRIOR = -1.5 * np.log(1 + np.exp(2 * LOG_SD) / 2) + LOG_SD  # half-t of two degrees of freedom, on a grid even in log sd


def of_estimate(estimate: float, error: float) -> np.ndarray:
    """Log likelihood of the estimate of one device over the grid."""
    variance = np.exp(2 * LOG_SD) + error**2
    return -0.5 * np.log(variance) - 0.5 * (estimate - MU) ** 2 / variance


def moments(log_p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and variance of log sd and of mu."""
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    values = np.stack([LOG_SD, MU])
    mean = np.sum(p * values, axis=(1, 2))
    return mean, np.sum(p * (values - mean[:, None, None]) ** 2, axis=(1, 2))


@pytest.fixture(scope="module")
def beliefs() -> Beliefs:
    """With draws from the grid."""
    total = PRIOR + sum(of_estimate(m, e) for m, e in zip(MEANS, ERRORS, strict=True))
    p = np.exp(total - total.max()).ravel()
    at = np.random.default_rng(1).choice(p.size, 2000, p=p / p.sum())
    mu, variance = MU.ravel()[at], np.exp(2 * LOG_SD.ravel()[at])
    drawn = Hierarchy(mu[None, :, None, None], variance[None, :, None, None], np.zeros((1, 2000, 8, 1)))
    return Beliefs.of(drawn, MEANS[:, None], (ERRORS**-2)[:, None, None], np.ones((8, 1)))


@pytest.mark.parametrize(("device", "error"), [(None, 0.05), (None, 0.8), (0, 0.2), (1, 0.2)])
def test_the_expected_fall_is_that_of_simulated_estimates(beliefs: Beliefs, device: int | None, error: float) -> None:
    """300 estimates drawn from the grid, each added to the data: how far the posterior variances fall on average."""
    each = [of_estimate(m, e) for m, e in zip(MEANS, ERRORS, strict=True)]
    total = PRIOR + sum(each)
    _, before = moments(total)
    rng = np.random.default_rng(2)
    p = np.exp(total - total.max()).ravel()
    after = []
    for at in rng.choice(p.size, 300, p=p / p.sum()):
        mu, sd = MU.ravel()[at], np.exp(LOG_SD.ravel()[at])
        if device is None:
            log_p = total + of_estimate(mu + np.hypot(sd, error) * rng.normal(), error)
        else:
            old, weight = MEANS[device], 1 / (1 + (ERRORS[device] / sd) ** 2)
            z = mu + weight * (old - mu) + np.sqrt(weight) * ERRORS[device] * rng.normal()
            new, precision = z + error * rng.normal(), np.array([ERRORS[device], error]) ** -2.0
            both = (precision @ [old, new]) / precision.sum()
            log_p = total - each[device] + of_estimate(both, precision.sum() ** -0.5)
        after.append(moments(log_p)[1])
    expected = 1 - np.mean(after, axis=0) / before
    found = beliefs.expected_fall(
        beliefs.of_new() if device is None else beliefs.of_device(device), np.array([[error**-2]])
    )
    for quantity, error_of_draws in ((0, 0.06), (1, 0.1)):  # log sd, mu
        assert found[quantity] == pytest.approx(expected[quantity], rel=error_of_draws, abs=5e-4)


def test_what_an_estimate_leaves_open_stays_open() -> None:
    """Of two parameters that are independently known, one is measured: what is known about the other does not change."""
    rng = np.random.default_rng(4)
    effects = 0.2 * rng.normal(size=(1, 2000, 1, 2))
    sd, correlation = np.exp(0.4 * rng.normal(size=(2000, 2)) - 1.0), rng.uniform(-0.9, 0.9, 2000)
    covariance = sd[:, :, None] * sd[:, None, :] * np.where(np.eye(2) > 0, 1.0, correlation[:, None, None])
    nine = np.zeros((9, 2)), np.tile(25.0 * np.eye(2), (9, 1, 1)), np.ones((9, 1))
    beliefs = Beliefs.of(Hierarchy(effects, covariance[None], np.zeros((1, 2000, 9, 2))), *nine)
    nothing = beliefs.expected_fall(beliefs.of_new(), np.zeros((2, 2)))
    np.testing.assert_allclose(nothing, 0.0, atol=1e-12)
    first = beliefs.expected_fall(beliefs.of_new(), np.diag([25.0, 0.0]))
    both = beliefs.expected_fall(beliefs.of_new(), np.diag([25.0, 25.0]))
    sd_0, sd_1, correlation, mean_0, mean_1 = range(5)
    assert min(first[sd_0], first[mean_0]) > 0.05
    assert max(first[sd_1], first[mean_1], first[correlation]) < 0.02
    assert (both[[sd_1, mean_1, correlation]] > first[[sd_1, mean_1, correlation]] + 0.02).all()
