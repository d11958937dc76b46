"""Loops that are fitted together beside `hystfit.fit` of each: random devices of several models, with white and slow noise.

    python -m tests.hard.maps [MODEL ...]    # 1000 loops, half an hour
    python -m tests.hard.maps --quick        # 60

Half of the loops share one input, as those of a map do; the others have inputs and lengths of their own. Some devices have a parameter on
its bound. Estimates must agree to 1e-6 of their standard errors, errors to 1e-3, and status and notes exactly. Exit status 1 otherwise.

The step of a model may have limits, at which the cost of a fit has a kink. Where its minimum lies on one, the gradient does not vanish at
the estimate, the derivatives on either side differ, and a solver ends within a hundredth of a standard error. The cost may also have a
minimum on either side of a kink: on the line between the two fits it rises above both, and each is the minimum of its side. The limit for
these is a tenth of a standard error, which no decision depends on. Loops of both kinds are counted.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

import hystfit as hf
from hystfit.batch.row import Row, row_of
from hystfit.models.base import AbstractHysteresis
from hystfit.params.space import ParameterSpace

SAMPLES = 800
MODELS: dict[str, AbstractHysteresis] = {
    "bouc-wen": hf.BoucWen(mu=0.45, tau=0.6, rho=0.4),
    "bouc-wen-asymmetric": hf.AsymmetricBoucWen(mu=0.45, tau=0.6, rho=0.4, skew=0.1),
    "bouc-wen-force": hf.BoucWenForce(),
    "duhem": hf.Duhem(alpha=1.0, f=[0.1, 1.0, 0.05], g=[0.5, 0.05], w0=0.0),
    "jiles-atherton": hf.JilesAtherton(Ms=1.0, a=0.4, coupling=0.5, k=0.3, c=0.2),
    "bouc-wen+lag": hf.Series(hf.Lag(tau=0.05), hf.BoucWen(mu=0.45, tau=0.6, rho=0.4)),
    "dahl": hf.Dahl(Fc=[0.3, 0.2, 0.4], d=[0.2, 0.6, 1.2], k=0.5),
    "prandtl-ishlinskii": hf.PrandtlIshlinskii(w=[[0.1, 0.2, 0.05, 0.3]], r=[0.05, 0.2, 0.6, 1.2], rise=[1.0]),
}
BOUND = "bouc-wen on a bound"  # devices whose rho is 1
SAME, ERRORS = 1e-6, 1e-3
ON_KINK = 1e-2  # of either, where the minimum lies at a kink
BESIDE_KINK = 0.1  # of either, where there is a minimum on both sides of one
STATIONARY = 1e-5  # standard errors that a Gauss-Newton step from a minimum is long, at most


class Difference(NamedTuple):
    """Between two rows: of estimates, in standard errors; of errors, relative; whether status, notes and reason are the same.

    `kink` says whether the minimum lies at a kink of the cost, and `two` whether both fits are minima of their own.
    """

    estimates: float
    errors: float
    same: bool
    kink: bool
    two: bool

    @property
    def wrong(self) -> bool:
        """Whether it is too large."""
        limits = (ON_KINK, ON_KINK) if self.kink else (SAME, ERRORS)
        limits = (BESIDE_KINK, BESIDE_KINK) if self.two else limits
        return self.estimates > limits[0] or self.errors > limits[1] or not self.same


def devices(name: str, count: int, seed: int, *, common: bool) -> list[hf.Record]:
    """Loops of devices about a model; a fifth of them with slow noise.

    Args:
        name: of the model.
        common: whether all have one input.
    """
    model = MODELS["bouc-wen" if name == BOUND else name]
    rng, space, records = np.random.default_rng(seed), ParameterSpace.of(model), list[hf.Record]()
    z = space.unconstrained(space.vector(model))
    while len(records) < count:
        samples = SAMPLES if common else int(rng.integers(SAMPLES - 30, SAMPLES + 200))
        size, frequency, phase = (2.0, 2.0, 0.0) if common else rng.uniform([1, 1.5, 0], [3, 2.5, 1])
        t = np.arange(samples) / 200
        u = size * np.sin(2 * np.pi * frequency * t + phase) * (0.3 + 0.7 * t / t[-1])
        one = space.tree(z + 0.2 * rng.normal(size=z.size))
        one = hf.BoucWen(one.c, one.mu, one.tau, 1.0, offset=one.offset) if name == BOUND else one
        y = np.asarray(hf.simulate(one, u, np.diff(t, prepend=t[0]))[0])
        white = rng.normal(size=u.size)
        slow = 0.3 * np.asarray(lfilter([1], [1, -0.95], rng.normal(size=u.size))) if len(records) % 5 == 4 else 0.0
        if np.isfinite(y).all() and np.ptp(y) > 0:
            y = y + rng.uniform(0.001, 0.01) * np.ptp(y) * (white + slow)
            records.append(hf.Record(u=u, y=y, t=t, name=f"loop {len(records)}"))
    return records


def at_kink(result: hf.FitResult) -> bool:
    """Whether the gradient does not vanish at an estimate inside its bounds."""
    problem, x = result.problem, np.asarray(result.x)
    if any(problem.at_bound(x)) or problem.space.linear.all():
        return False
    misfit, J = (np.asarray(v) for v in problem.objective.linearize_at(jnp.asarray(problem.space.unconstrained(x))))
    step = np.linalg.lstsq(J.T, misfit, rcond=None)[0] @ J
    return float(np.linalg.norm(step)) > STATIONARY * float(np.linalg.norm(misfit)) / np.sqrt(misfit.size)


def two_minima(result: hf.FitResult, other: np.ndarray) -> bool:
    """Whether the cost rises on the line from an estimate to another one, and falls again."""
    costs = [np.sum(result.problem.misfit(result.x + part * (other - result.x)) ** 2) for part in np.linspace(0, 1, 41)]
    return bool(max(costs) > (1 + 1e-9) * max(costs[0], costs[-1]))


def difference(row: Row, result: hf.FitResult, record: hf.Record) -> Difference:
    """Between a row and that of `hystfit.fit`."""
    wanted = row_of(row.name, "", record, result)
    apart, errors = 0.0, 0.0
    for name, value in wanted.values.items():
        error, mine = wanted.stderr[name], row.stderr[name]
        if error is None or mine is None:
            errors = max(errors, 0.0 if error is mine else np.inf)
            continue
        apart = max(apart, abs(row.values[name] - value) / error)
        errors = max(errors, abs(mine / error - 1))
    same = (row.status, row.codes, row.reason) == (wanted.status, wanted.codes, wanted.reason)
    two = apart > SAME and two_minima(result, np.array([*row.values.values()]))
    return Difference(apart, errors, same, at_kink(result), two)


def compared(name: str, count: int, seed: int, *, common: bool) -> list[Difference]:
    """Differences of the loops of one model."""
    records, model = devices(name, count, seed, common=common), "bouc-wen" if name == BOUND else name
    fits = hf.fit_many(model, records)
    return [difference(row, hf.fit(model, record), record) for row, record in zip(fits, records, strict=True)]


def main(names: list[str], loops: int) -> int:
    """Print the table; 1 where something differs."""
    hf.enable_x64()
    begun, wrong = time.process_time(), 0
    print(
        "model                input     loops  estimates [errors]   errors  status or notes differ    at a kink  estimates   errors"
    )
    for number, name in enumerate(names):
        for common in (True, False):
            rows = compared(name, -(-loops // (2 * len(names))), 2 * number + common, common=common)
            kinked = [row for row in rows if row.kink or row.two]
            others = [row for row in rows if not (row.kink or row.two)]
            largest = [
                f"{max((getattr(row, part) for row in some), default=0.0):.1e}"
                for some in (others, kinked)
                for part in ("estimates", "errors")
            ]
            differ = sum(not row.same for row in rows)
            wrong += sum(row.wrong for row in rows)
            kind = "one" if common else "of each"
            print(
                f"{name:<20} {kind:<8} {len(rows):>6} {largest[0]:>19} {largest[1]:>8} {differ:>23} {len(kinked):>12} {largest[2]:>10} "
                f"{largest[3]:>8}",
                flush=True,
            )
    print(f"{wrong} loops differ, {time.process_time() - begun:.0f} s of processor time")
    return int(wrong > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("models", nargs="*", default=[*MODELS, BOUND], help="all by default")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    sys.exit(main(options.models, 60 if options.quick else 1000))
