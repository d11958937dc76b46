"""A whole fit of Bouc-Wen (5 parameters) beside least squares of scipy, lmfit and jaxopt on the same samples.

The peers solve from one start and report nothing; `hystfit.fit` searches from 8 starts (or 1) and also gives errors, the noise and a
verdict. All end at the same cost, which is checked before anything is timed.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.signal
from loops import bouc_wen
from rows import Row, beside
from steps import BOUC_WEN, signal
from timing import alternate

import hystfit as hf

START = np.array([1.2, 0.3, 1.0, 0.2, 0.0])
LOWER, UPPER = np.array([1e-6, 1e-6, 1e-6, -0.999, -np.inf]), np.array([np.inf, 0.999, np.inf, 0.999, np.inf])
NAMES = ("c", "mu", "tau", "rho", "offset")


def record(samples: int, seed: int = 0, slow: float = 0.0) -> hf.Record:
    """A record of known parameters with white noise, and slow noise over 50 samples of a standard deviation `slow`."""
    u, rng = signal(samples), np.random.default_rng(seed)
    y = np.asarray(hf.simulate(hf.BoucWen(**BOUC_WEN), u)[0])
    noise = rng.normal(0, 0.003, samples)
    if slow:
        noise = noise + scipy.signal.lfilter([slow * np.sqrt(1 - 0.98**2)], [1, -0.98], rng.standard_normal(samples))
    return hf.Record(u=u, y=y + noise, t=np.linspace(0, 20, samples), name=f"record {seed}")


def residual(data: hf.Record) -> Callable[[np.ndarray], np.ndarray]:
    """Simulated minus measured output by a numba loop."""
    u, y, zero = np.array(data.u), np.array(data.y), np.zeros(len(data))
    return lambda x: bouc_wen(u, zero, x[0], x[1], x[2], x[3], 0.0, x[4]) - y


def by_scipy(data: hf.Record) -> Callable[[], float]:
    """Trust-region least squares with differences; returns the cost."""
    run = residual(data)
    return lambda: float(scipy.optimize.least_squares(run, START, bounds=(LOWER, UPPER), x_scale="jac").cost)


def by_lmfit(data: hf.Record) -> Callable[[], float]:
    import lmfit

    run = residual(data)
    parameters = lmfit.Parameters()
    for name, value, low, high in zip(NAMES, START, LOWER, UPPER, strict=True):
        parameters.add(name, value=value, min=low, max=high)
    return lambda: 0.5 * float(lmfit.minimize(lambda p: run(np.array([p[n].value for n in NAMES])), parameters).chisqr)


def by_jaxopt(data: hf.Record) -> Callable[[], float]:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt

    u, y = jnp.asarray(data.u), jnp.asarray(data.y)

    def misfit(x: Any, u: jax.Array, y: jax.Array) -> jax.Array:
        return hf.simulate(hf.BoucWen(**dict(zip(NAMES, x, strict=True))), u)[0] - y

    solver = jaxopt.LevenbergMarquardt(misfit, materialize_jac=True, maxiter=50, tol=1e-8)
    run = jax.jit(lambda x, u, y: solver.run(x, u, y).params)
    return lambda: 0.5 * float(jnp.sum(misfit(run(jnp.asarray(START), u, y), u, y) ** 2))


PEERS = {"scipy trf + numba": by_scipy, "lmfit + numba": by_lmfit, "jaxopt LM": by_jaxopt}
NEEDS = {"lmfit + numba": "lmfit", "jaxopt LM": "jaxopt"}


def one(samples: int, repeats: int, peers: tuple[str, ...]) -> list[Row]:
    """The default fit, and one from a single start, beside peers.

    Args:
        samples: of the record.
        repeats: of each.
        peers: their names.
    """
    data = record(samples)
    absent = [name for name in peers if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None]
    calls: dict[str, Callable[[], Any]] = {name: PEERS[name](data) for name in peers if name not in absent}
    fitted = hf.fit(hf.BoucWen(), data)
    cost = 0.5 * float(np.nansum(fitted.residuals**2))
    for name, call in calls.items():
        np.testing.assert_allclose(call(), cost, rtol=1e-3, err_msg=name)
    calls |= {
        "hystfit": lambda: hf.fit(hf.BoucWen(), data),
        "one start": lambda: hf.fit(hf.BoucWen(), data, starts=1),
    }
    times = alternate(calls, repeats)
    single = times.pop("one start")
    rows = beside(times, f"fit of {samples} samples")
    rows += [
        Row(f"fit of {samples} samples, starts=1 / {row.name.partition(' / ')[2]}", single, row.peer_s) for row in rows
    ]
    return rows + [
        Row(f"fit of {samples} samples / {name}", times["hystfit"], None, "not installed") for name in absent
    ]


def correlated(samples: int, repeats: int) -> list[Row]:
    """The default fit of a record with slow noise, whose standard errors need the covariance of that noise.

    Args:
        samples: of the record.
        repeats: of each.
    """
    data = record(samples, slow=0.01)
    calls: dict[str, Callable[[], Any]] = {"scipy trf + numba": by_scipy(data)}
    calls["hystfit"] = lambda: hf.fit(hf.BoucWen(), data)
    return beside(alternate(calls, repeats), f"fit of {samples} samples, autocorrelated residuals")


def many(records: int, samples: int, repeats: int) -> list[Row]:
    """Several records one after another, and together by `fit_many`, from 8 starts and with everything that a row reports.

    Args:
        records: how many.
        samples: of each.
        repeats: of each.
    """
    data = [record(samples, seed) for seed in range(records)]
    solves = [by_scipy(each) for each in data]
    calls = {
        "hystfit": lambda: [hf.fit(hf.BoucWen(), each, starts=1).x for each in data],
        "fit_many": lambda: hf.fit_many("bouc-wen", data).values("tau"),
        "scipy trf + numba": lambda: [solve() for solve in solves],
    }
    times = alternate(calls, repeats)
    together = times.pop("fit_many")
    rows = beside(times, f"{records} fits of {samples} samples, starts=1")
    return [
        *rows,
        Row(f"fit_many of {records} records of {samples} samples / scipy trf + numba", together, rows[0].peer_s),
    ]


def measure(quick: bool) -> list[Row]:
    """Rows of the suite."""
    if quick:
        return one(500, 1, tuple(PEERS)) + correlated(500, 1) + many(2, 500, 1)
    rows = one(10_000, 5, tuple(PEERS)) + correlated(10_000, 5) + one(1_000_000, 1, ("scipy trf + numba",))
    return rows + many(10, 10_000, 1)


if __name__ == "__main__":
    from run import alone

    alone("fit")
