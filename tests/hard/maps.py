"""Loops that are fitted together beside `hystfit.fit` of each: random devices of five models, with white and slow noise.

    python -m tests.hard.maps            # 1000 loops, half an hour
    python -m tests.hard.maps --quick    # 60

Half of the loops share one input, as those of a map do; the others have inputs and lengths of their own. Estimates must agree to 3e-6 of
their standard errors, errors to 1e-3, and status and notes exactly. Exit status 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

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
    "bouc-wen+lag": hf.Series(hf.Lag(tau=0.05), hf.BoucWen(mu=0.45, tau=0.6, rho=0.4)),
}
# A fit alone ends where the cost may decrease by 1e-14 of itself: at 900 samples that is 3e-6 standard errors.
SAME, ERRORS = 3e-6, 1e-3


class Difference(NamedTuple):
    """Between two rows: of estimates, in standard errors; of errors, relative; whether status, notes and reason are the same."""

    estimates: float
    errors: float
    same: bool


def devices(model: AbstractHysteresis, count: int, seed: int, *, common: bool) -> list[hf.Record]:
    """Loops of devices about a model; a fifth of them with slow noise.

    Args:
        common: whether all have one input.
    """
    rng, space, records = np.random.default_rng(seed), ParameterSpace.of(model), list[hf.Record]()
    z = space.unconstrained(space.vector(model))
    while len(records) < count:
        samples = SAMPLES if common else int(rng.integers(SAMPLES - 30, SAMPLES + 200))
        size, frequency, phase = (2.0, 2.0, 0.0) if common else rng.uniform([1, 1.5, 0], [3, 2.5, 1])
        t = np.arange(samples) / 200
        u = size * np.sin(2 * np.pi * frequency * t + phase) * (0.3 + 0.7 * t / t[-1])
        one = space.tree(z + 0.2 * rng.normal(size=z.size))
        y = np.asarray(hf.simulate(one, u, np.diff(t, prepend=t[0]))[0])
        white = rng.normal(size=u.size)
        slow = 0.3 * lfilter([1], [1, -0.95], rng.normal(size=u.size)) if len(records) % 5 == 4 else 0.0
        if np.isfinite(y).all() and np.ptp(y) > 0:
            y = y + rng.uniform(0.001, 0.01) * np.ptp(y) * (white + slow)
            records.append(hf.Record(u=u, y=y, t=t, name=f"loop {len(records)}"))
    return records


def difference(row: Row, wanted: Row) -> Difference:
    """Between a row and that of `hystfit.fit`."""
    apart, errors = 0.0, 0.0
    for name, value in wanted.values.items():
        error, mine = wanted.stderr[name], row.stderr[name]
        if error is None or mine is None:
            errors = max(errors, 0.0 if error is mine else np.inf)
            continue
        apart = max(apart, abs(row.values[name] - value) / error)
        errors = max(errors, abs(mine / error - 1))
    same = (row.status, row.codes, row.reason) == (wanted.status, wanted.codes, wanted.reason)
    return Difference(apart, errors, same)


def compared(name: str, count: int, seed: int, *, common: bool) -> list[Difference]:
    """Differences of the loops of one model."""
    records = devices(MODELS[name], count, seed, common=common)
    fits = hf.fit_many(name, records)
    return [
        difference(row, row_of(row.name, "", record, hf.fit(name, record)))
        for row, record in zip(fits, records, strict=True)
    ]


def main(loops: int) -> int:
    """Print the table; 1 where something differs."""
    hf.enable_x64()
    begun, wrong = time.perf_counter(), 0
    print("model                input     loops  estimates [errors]   errors  status or notes differ")
    for number, name in enumerate(MODELS):
        for common in (True, False):
            rows = compared(name, loops // (2 * len(MODELS)), 2 * number + common, common=common)
            apart, errors = max(row.estimates for row in rows), max(row.errors for row in rows)
            differ = sum(not row.same for row in rows)
            wrong += sum(row.estimates > SAME or row.errors > ERRORS or not row.same for row in rows)
            kind = "one" if common else "of each"
            print(f"{name:<20} {kind:<8} {len(rows):>6} {apart:>19.1e} {errors:>8.1e} {differ:>23}", flush=True)
    print(f"{wrong} loops differ, {time.perf_counter() - begun:.0f} s")
    return int(wrong > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    sys.exit(main(60 if parser.parse_args().quick else 1000))
