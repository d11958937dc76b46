"""Time of many fits at once, with ratios in one run: `python benchmarks/many.py [--quick]`.

100 Bouc-Wen records of 10 000 samples, each over an input of its own, beside scipy's trust region on a numba loop, one after another.
Both start from the values read off each record, on one core. scipy gives estimates alone; the last line adds starting values from eight
points, standard errors, noise and verdict. Then 10 000 loops of 1000 samples over one input from an HDF5 file, with everything; one in a
hundred has slow noise. Then 1000 CSV files of 1000 samples, read and fitted in one process. Times are those of the processor, which other
work on the machine changes less than the clock.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import h5py
import numba
import numpy as np
import scipy.optimize
from scipy.signal import lfilter

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
        started = time.process_time()
        run()  # type: ignore[operator]
        times.append(time.process_time() - started)
    return min(times)


def cube(loops: int, samples: int) -> None:
    """A map from one file: wall time, processor time and memory."""
    with tempfile.TemporaryDirectory() as folder, h5py.File(Path(folder) / "cube.h5", "w") as file:
        t = np.linspace(0, 20, samples)
        u = (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t)
        rng, data = np.random.default_rng(0), file.create_dataset("y", (loops // 100, 100, samples), float)
        for row in range(loops // 100):
            for column in range(100):
                c, tau = np.exp(0.2 * rng.normal()), 1.5 * np.exp(0.1 * rng.normal())
                y = np.empty(samples)
                miss((c, 0.45, tau, 0.5, 0.3), u, np.zeros(samples), y)
                noise: np.ndarray = rng.standard_normal(samples)
                if column == 0:
                    noise += 0.3 * np.asarray(lfilter([1.0], [1.0, -0.95], rng.standard_normal(samples)))
                data[row, column] = y + 0.003 * np.ptp(y) * noise
        begin, used = time.perf_counter(), time.process_time()
        found = hf.fit_map("bouc-wen", u, data, t)
    seconds, used = time.perf_counter() - begin, time.process_time() - used
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    counted = ", ".join(f"{count} {status}" for status, count in found.counts.items())
    print(
        f"{loops} loops of {samples} samples from one HDF5 file: {seconds:.1f} s, {used:.1f} s of processor time, {memory:.2f} GiB"
    )
    print(f"{counted}; {int(found.alone.sum())} fitted alone")


def files(count: int, samples: int) -> None:
    """A folder of CSV files."""
    t, rng = np.linspace(0, 20, samples), np.random.default_rng(0)
    u = (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t)
    y, header = np.empty(samples), "time [s],voltage [V],displacement [um]"
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            miss(
                (np.exp(0.2 * rng.normal()), 0.45, 1.5 * np.exp(0.1 * rng.normal()), 0.5, 0.3), u, np.zeros(samples), y
            )
            columns = np.column_stack([t, u, y + 0.003 * np.ptp(y) * rng.normal(size=samples)])
            np.savetxt(Path(folder) / f"{number}.csv", columns, "%.9g", delimiter=",", header=header, comments="")
        begin, used = time.perf_counter(), time.process_time()
        found = hf.fit_many("bouc-wen", f"{folder}/*.csv")
        seconds, used = time.perf_counter() - begin, time.process_time() - used
    counted = ", ".join(f"{number} {status}" for status, number in found.counts.items())
    print(f"{count} CSV files of {samples} samples: {seconds:.1f} s, {used:.1f} s of processor time; {counted}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="little work, which proves that everything runs")
    parser.add_argument("parts", nargs="*", help="records, cube, files; all by default")
    chosen = parser.parse_args()
    hf.enable_x64()
    parts = {
        "records": lambda: records_of_their_own(4 if chosen.quick else RECORDS),
        "cube": lambda: cube(*((200, 400) if chosen.quick else (10_000, 1000))),
        "files": lambda: files(*((20, 400) if chosen.quick else (1000, 1000))),
    }
    for name in chosen.parts or parts:
        parts[name]()


def records_of_their_own(count: int) -> None:
    """Records over different inputs, beside scipy."""
    records = [made(seed) for seed in range(count)]
    posed = [set_up_fit(hf.BoucWen(), hf.Dataset((record,)), FitOptions()) for record in records]
    tasks = {
        starts: [Task.of(p.problem, starting_vectors(p.problem, starts, 0, p.points)) for p in posed]
        for starts in (1, 8)
    }

    def together(starts: int) -> np.ndarray:
        return np.array([np.nan if e is None else e.cost for e in solve_together(tasks[starts])])

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
            f"{name:<30} {seconds:>7.2f} s {1e3 * seconds / count:>8.2f} ms a record {reference / seconds:>6.2f} times as fast"
        )


if __name__ == "__main__":
    main()
