"""Time of many fits at once: 100 Bouc-Wen records of 10 000 samples, beside scipy's trust region on a numba loop, one after another.

Both start from the values read off each record, on one core. scipy gives estimates alone; the last line adds starting values from
eight points, standard errors, noise and verdict.
"""

import time

import numba
import numpy as np
import scipy.optimize

import hystfit as hf
from hystfit.batch.bucketed import Task, solve_together
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import set_up_fit, starting_vectors

RECORDS, SAMPLES, REPEATS = 100, 10_000, 3


@numba.njit
def miss(x, u, y, out):
    c, mu, tau, rho, offset = x
    highest, h, before = mu * c / (tau * (1 + rho)), 0.0, u[0]
    for k in range(u.size):
        dv = u[k] - before
        before = u[k]
        way = abs(dv)
        below = min(max((h if dv < 0 else -h) / (mu * c), 0.0), way)
        half = 0.5 * (tau * (1 + rho) * (way - below) + tau * (1 - rho) * below)
        h = min(max(((1 - half) * h + mu * c * dv) / (1 + half), -highest), highest)
        out[k] = offset + c * u[k] - h - y[k]
    return out


def made(seed: int) -> hf.Record:
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 20, SAMPLES)
    u = (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t + 0.1 * seed)
    tau = 1.5 * np.exp(0.2 * rng.standard_normal())
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.45, tau=tau, rho=0.5, offset=0.3), u)[0])
    return hf.Record(u=u, y=y + rng.normal(0, 0.003, SAMPLES), t=t, name=f"loop {seed}")


def best(run: object) -> float:
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        run()  # type: ignore[operator]
        times.append(time.perf_counter() - started)
    return min(times)


def main() -> None:
    hf.enable_x64()
    records = [made(seed) for seed in range(RECORDS)]
    posed = [set_up_fit(hf.BoucWen(), hf.Dataset((record,)), FitOptions()) for record in records]
    tasks = {
        count: [Task.of(p.problem, starting_vectors(p.problem, count, 0, p.points)) for p in posed] for count in (1, 8)
    }

    def together(count: int) -> np.ndarray:
        return np.array([np.nan if e is None else e.cost for e in solve_together(tasks[count])])

    def in_a_loop() -> np.ndarray:
        costs = []
        for record, p in zip(records, posed, strict=True):
            c, out = p.problem.space.coordinates, np.empty(SAMPLES)
            found = scipy.optimize.least_squares(
                lambda x, record=record, out=out: miss(x, record.u, record.y, out).copy(),
                p.problem.space.vector(p.points[0]),
                bounds=(np.asarray(c.lower), np.asarray(c.upper)),
                x_scale="jac",
            )
            costs.append(found.cost / p.problem.scales.y**2)
        return np.array(costs)

    ours, theirs = together(1), in_a_loop()  # compiles
    together(8)
    print(
        f"largest excess of our cost over scipy's: {np.nanmax(ours / theirs - 1):.1e}; without result: {np.isnan(ours).sum()}"
    )
    reference = best(in_a_loop)
    lines = {
        "scipy trf + numba, in a loop": reference,
        "together, one start": best(lambda: together(1)),
        "together, eight starts": best(lambda: together(8)),
        "fit_many, everything": best(lambda: hf.fit_many("bouc-wen", records)),
    }
    for name, seconds in lines.items():
        print(
            f"{name:<30} {seconds:>7.2f} s {1e3 * seconds / RECORDS:>8.2f} ms a record {reference / seconds:>6.2f} times as fast"
        )


if __name__ == "__main__":
    main()
