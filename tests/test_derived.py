"""Quantities that follow from draws: against a plain loop, a closed form, and the inverse of each draw on its own."""

import dataclasses

import numpy as np
import pytest

import hystfit as hf
from hystfit.control.bands import inverse_bands
from hystfit.errors import ParameterError
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior

TRUTH = hf.BoucWen(c=1.2, mu=0.5, tau=2.0, rho=0.4, offset=0.3)


def drawn(fit: hf.FitResult, rows: np.ndarray) -> Posterior:
    """A posterior of given draws (n, p)."""
    d = rows.shape[1]
    nothing = Convergence(*(np.ones(d) for _ in range(3)))
    return Posterior(
        fit, "nuts", "iid", tuple(fit.free_names), ("",) * d, rows[None], np.zeros((1, len(rows))), {}, nothing,
        Status.OK, (), {}, 0.0, 0, {},
    )  # fmt: skip


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    T = 600
    u = np.sin(2 * np.pi * 4 * np.arange(T) / T) * np.linspace(0.4, 1.0, T)
    u[-1] = 1.0
    u[-80] = -1.0
    y = np.asarray(hf.simulate(TRUTH, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=T)
    fit = hf.fit(TRUTH, hf.Record(u=u, y=y, u_unit="V", y_unit="um"), starts=1, noise="iid")
    assert tuple(fit.free_names) == ("c", "mu", "tau", "rho", "offset")
    rows = np.array([[1.2, 0.5, 2.0, 0.4, 0.3], [1.1, 0.6, 3.0, 0.2, 0.25], [1.3, 0.45, 1.5, 0.5, 0.35]])
    return drawn(fit, rows)


def plain_loop(c: float, mu: float, tau: float, rho: float, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input, rising and falling branch of the steady loop between -1 and 1, by Euler steps of 1e-4."""
    steps, h, branches = 20_000, 0.0, []
    for sign in (1, -1, 1, -1, 1):
        branch = np.empty(steps + 1)
        branch[0] = h
        for k in range(steps):
            h += sign * 1e-4 * (mu * c - sign * tau * (np.sign(h) + sign * rho) * abs(h))
            branch[k + 1] = h
        branches.append(branch)
    u = np.linspace(-1, 1, steps + 1)
    return u, offset + c * u - branches[4], offset + c * u - branches[3][::-1]


def test_numbers_of_the_loop_are_those_of_a_plain_loop(posterior):
    found = posterior.derived(count=3)
    rows = posterior.thinned(3)
    for k, row in enumerate(rows):
        u, rising, falling = plain_loop(*row)
        area = abs(np.trapezoid(falling - rising, u))
        middle = 0.5 * (max(rising.max(), falling.max()) + min(rising.min(), falling.min()))
        at = lambda branch, middle=middle, u=u: float(np.interp(middle, branch, u))
        assert found["loop_area"][k] == pytest.approx(area, rel=2e-3)
        assert found["coercive_input"][k] == pytest.approx(0.5 * abs(at(rising) - at(falling)), rel=2e-3)
        assert found["remanence"][k] == pytest.approx(0.5 * abs(np.interp(0, u, falling - rising)), rel=2e-3)
        stroke = max(rising.max(), falling.max()) - min(rising.min(), falling.min())
        assert found["hysteresis_percent"][k] == pytest.approx(100 * np.abs(falling - rising).max() / stroke, rel=2e-3)
    table = {row["name"]: row for row in posterior.derived_rows}
    assert table["loop_area"]["unit"] == "um V"
    assert table["coercive_input"]["unit"] == "V"
    assert table["remanence"]["lower"] <= table["remanence"]["median"] <= table["remanence"]["upper"]
    with pytest.raises(ParameterError, match="no creep"):
        posterior.derived(["creep_percent_per_decade"])
    with pytest.raises(ParameterError, match="no quantity"):
        posterior.derived(["loop_color"])


def test_creep_in_a_decade_is_that_of_the_closed_form():
    T, dt = 400, 0.05
    model = hf.Sum(hf.BoucWen(c=1.0, mu=0.0, tau=1.0, rho=0.0), hf.LinearCreep(a=(0.2,), tau=(3.0,)))
    u = np.sin(2 * np.pi * np.arange(T) / 100)
    y = np.asarray(hf.simulate(model, u, dt)[0]) + 1e-3 * np.random.default_rng(0).normal(size=T)
    names = hf.ParameterSpace.of(model).names
    free = [name for name in names if name.startswith("a[")]
    fit = hf.fit(
        model,
        hf.Record(u=u, y=y, t=dt * np.arange(T)),
        fix=[n for n in names if n not in free],
        start="model",
        starts=1,
    )
    found = drawn(fit, np.array([[0.2], [0.4]]))
    got = dict(
        zip(
            found.thinned(2)[:, 0],
            found.derived(["creep_percent_per_decade"], 2)["creep_percent_per_decade"],
            strict=True,
        )
    )
    low, high = u.min(), u.max()
    creep = fit.model.parts[1]
    size, tau = float(creep.high - creep.low), 3.0
    for a in (0.2, 0.4):
        # The actuator has rested on `low` for long, so that the step excites the creep of the whole range.
        after = lambda t, a=a: a * (high - low) / size * -np.expm1(-t / tau)
        step = (high - low) + after(1.0)
        assert got[a] == pytest.approx(100 * (after(10.0) - after(1.0)) / step, rel=0.02)


def test_inverse_bands_are_each_draws_inverse_and_its_error_under_the_input_given(posterior):
    reference = 0.3 + 0.6 * np.sin(2 * np.pi * np.arange(120) / 60)
    bands = inverse_bands(posterior, reference, count=3)
    for row, u, error in zip(posterior.thinned(3), bands.u, bands.error, strict=True):
        model = hf.BoucWen(**dict(zip(("c", "mu", "tau", "rho", "offset"), row, strict=True)))
        np.testing.assert_allclose(np.asarray(hf.simulate(model, u)[0])[1:], reference[1:], atol=1e-6)
        np.testing.assert_allclose(error, np.asarray(hf.simulate(model, bands.given.u)[0]) - reference, atol=1e-12)
    np.testing.assert_allclose(bands.rms, np.sqrt(np.mean(bands.error**2, axis=1)))
    assert bands.rms.min() < 0.02 < bands.rms.max()  # the draw near the fit follows, the others do not
    rested = inverse_bands(posterior, reference, count=3, rest=-1.0)
    for model, u, error in zip(posterior.models(3), rested.u, rested.error, strict=True):
        before = lambda inputs: np.concatenate([[-1.0], inputs])
        np.testing.assert_allclose(np.asarray(hf.simulate(model, before(u))[0])[1:], reference, atol=1e-6)
        np.testing.assert_allclose(
            error, np.asarray(hf.simulate(model, before(rested.given.u))[0])[1:] - reference, atol=1e-12
        )
    low, middle, high = bands.band("error")
    assert np.all((low <= middle) & (middle <= high))
    with pytest.raises(ParameterError, match="a band is of"):
        bands.band("y")
    alone = dataclasses.replace(bands, u=bands.u[:1])
    np.testing.assert_array_equal(alone.band("u")[0], bands.u[0])
