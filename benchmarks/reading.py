"""Time to read a long text file beside pandas and numpy.loadtxt on the same numbers."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from rows import Row, beside
from timing import alternate

import hystfit as hf


def measure(quick: bool) -> list[Row]:
    """Rows of the suite."""
    import pandas

    count, repeats = (2_000, 1) if quick else (200_000, 5)
    values = np.column_stack([np.arange(count) * 0.005, np.random.default_rng(0).normal(size=(count, 2))])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        path.write_text("t_s,u_V,y_um\n" + "".join(f"{a:.3f},{b!r},{c!r}\n" for a, b, c in values.tolist()))
        calls = {
            "hystfit": lambda: hf.read_csv(path),
            "pandas": lambda: pandas.read_csv(path),
            "numpy.loadtxt": lambda: np.loadtxt(path, delimiter=",", skiprows=1),
        }
        return beside(alternate(calls, repeats), f"read {count} rows")


if __name__ == "__main__":
    from run import alone

    alone("reading")
