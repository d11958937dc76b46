"""Other programs on the tasks of the field, from the files that `run.py --write` makes.

    python experiments/field/peers.py PEER FOLDER PREDICTIONS

PEER is "sysidentpy" or "RESSPyLab". It needs that package and its needs alone, so that it runs in an environment of its own. Tasks that a
package has no model for are left out. Prints the number of fitted parameters and the seconds of each task; `run.py --score PREDICTIONS`
prints the errors.
"""

from __future__ import annotations

import csv
import itertools
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

Rows = list[dict[str, str]]


def _columns(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Input and output, NaN where it is asked."""
    return np.array([float(row["u"]) for row in rows]), np.array([float(row["y"] or "nan") for row in rows])


def _runs(known: np.ndarray) -> list[tuple[int, int]]:
    """First sample and end of each run of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(known.astype(int))) + 1).tolist(), known.size]
    return list(itertools.pairwise(edges))


def sysidentpy(rows: Rows) -> tuple[np.ndarray, int] | None:
    """Polynomial NARX of degree 2 with the sign of the input's rate, terms by FROLS; simulated freely from the last given outputs."""
    from sysidentpy.basis_function import Polynomial  # pyrefly: ignore[missing-import]
    from sysidentpy.model_structure_selection import FROLS  # pyrefly: ignore[missing-import]

    records = np.array([row["record"] for row in rows])
    u, y = _columns(rows)
    known, lags = np.isfinite(y), 2
    if len(set(records[known])) > 1:
        return None  # it is fitted to one continuous record
    span, center, deviation = np.ptp(u[known]), y[known].mean(), y[known].std()
    columns, scaled = np.empty((u.size, 2)), (y - center) / deviation
    for name in dict.fromkeys(records):
        part = records == name
        columns[part] = np.column_stack([u[part] / span, np.sign(np.gradient(u[part]))])
    begin, end = max(_runs(known), key=lambda run: known[run[0]] * (run[1] - run[0]))
    model = FROLS(
        order_selection=True, n_info_values=20, ylag=lags, xlag=[[1, 2], [1, 2]], basis_function=Polynomial(degree=2)
    )
    model.fit(X=columns[begin:end], y=scaled[begin:end, None])
    slope, level = np.polyfit(u[known], scaled[known], 1)
    for name in dict.fromkeys(records):
        offset = int(np.flatnonzero(records == name)[0])
        for first, last in _runs(known[records == name]):
            first, last = first + offset, last + offset
            if known[first]:
                continue
            lead = first - lags if first > offset else first
            start = np.where(
                known[lead : lead + lags], scaled[lead : lead + lags], level + slope * u[lead : lead + lags]
            )
            free = model.predict(X=columns[lead:last], y=start[:, None])
            y[lead:last] = np.where(known[lead:last], y[lead:last], center + deviation * np.ravel(free))
    return y, len(np.ravel(model.theta))


def resspylab(rows: Rows) -> tuple[np.ndarray, int] | None:
    """Voce-Chaboche with two backstresses, from nominal values; for steel coupons."""
    import pandas as pd
    from RESSPyLab import VCsimCurve, vc_param_opt  # pyrefly: ignore[missing-import]

    u, y = _columns(rows)
    known = np.isfinite(y)
    if not known[0] or rows[0]["record"] != "steel_resspylab/example_1":
        return None
    start = [200e3, 355.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]  # nominal modulus and yield stress [MPa]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "train.csv"
        pd.DataFrame({"e_true": u[known], "Sigma_true": y[known]}).to_csv(path, index=False)
        found = vc_param_opt(start, [str(path)], "", "", filter_data=False)
    test = pd.DataFrame({"e_true": u, "Sigma_true": np.nan_to_num(y)})
    simulated = np.asarray(VCsimCurve(found, test)["Sigma_true"], dtype=float)
    return simulated, len(found)


PEERS: dict[str, Callable[[Rows], tuple[np.ndarray, int] | None]] = {"sysidentpy": sysidentpy, "RESSPyLab": resspylab}


def main() -> None:
    """Fill in the column y of each task."""
    peer, folder, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted(folder.glob("*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        began = time.perf_counter()
        if (found := PEERS[peer](rows)) is None:
            continue
        outputs, parameters = found
        with (out / path.name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(list(rows[0]))
            writer.writerows(
                [row["record"], row["t"], row["u"], value] for row, value in zip(rows, outputs, strict=True)
            )
        print(f"{path.stem:<24} {parameters} parameters, {time.perf_counter() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
