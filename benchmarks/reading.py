"""Time to read a long text file, against numpy.loadtxt on the same numbers."""

import tempfile
import time
from pathlib import Path

import numpy as np

import hystfit as hf

ROWS, REPEATS = 200_000, 5


def main() -> None:
    rows = np.column_stack([np.arange(ROWS) * 0.005, np.random.default_rng(0).normal(size=(ROWS, 2))])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        path.write_text("t_s,u_V,y_um\n" + "".join(f"{a:.3f},{b!r},{c!r}\n" for a, b, c in rows.tolist()))
        hf.read_csv(path)
        times: dict[str, list[float]] = {"hystfit": [], "numpy": []}
        for _ in range(REPEATS):
            for name, read in (("hystfit", hf.read_csv), ("numpy", lambda p: np.loadtxt(p, delimiter=",", skiprows=1))):
                started = time.perf_counter()
                read(path)
                times[name].append(time.perf_counter() - started)
    ours, theirs = (float(np.median(times[name])) for name in ("hystfit", "numpy"))
    print(f"{ROWS} rows, median of {REPEATS}: {ours:.2f} s, numpy.loadtxt {theirs:.2f} s, ratio {ours / theirs:.1f}")


if __name__ == "__main__":
    main()
