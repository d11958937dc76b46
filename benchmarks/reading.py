"""Processor time to read a long text file, against numpy.loadtxt and pandas.read_csv on the same numbers."""

import tempfile
import time
from pathlib import Path
from types import ModuleType

import numpy as np

import hystfit as hf

ROWS, REPEATS = 200_000, 5


def main() -> None:
    rows = np.column_stack([np.arange(ROWS) * 0.005, np.random.default_rng(0).normal(size=(ROWS, 2))])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        path.write_text("t_s,u_V,y_um\n" + "".join(f"{a:.3f},{b!r},{c!r}\n" for a, b, c in rows.tolist()))
        hf.read_csv(path)
        readers = {
            "hystfit with numpy": hf.read_csv,
            "numpy": lambda p: np.loadtxt(p, delimiter=",", skiprows=1),
            "pandas": lambda p: _pandas().read_csv(p),
            "hystfit with pandas": hf.read_csv,  # whose parser it uses once pandas is imported
        }
        times: dict[str, float] = {}
        for name, read in readers.items():
            read(path)
            laps = []
            for _ in range(REPEATS):
                started = time.process_time()
                read(path)
                laps.append(time.process_time() - started)
            times[name] = min(laps)
    print(
        f"{ROWS} rows, processor time, best of {REPEATS}: "
        + ", ".join(f"{name} {taken:.3f} s" for name, taken in times.items())
    )
    print(f"hystfit / numpy {times['hystfit with numpy'] / times['numpy']:.1f}")
    print(f"hystfit / pandas {times['hystfit with pandas'] / times['pandas']:.1f}")


def _pandas() -> ModuleType:
    import pandas

    return pandas


if __name__ == "__main__":
    main()
