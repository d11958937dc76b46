"""Write the bundled records: the simulated piezo actuator on four excitations, with their checksums.

python data/make.py [FOLDER]
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit import signals
from hystfit.data.record import Record
from hystfit.stage import Actuator

FINER = 10  # simulated samples per recorded one


def sine(rate: float = 400.0) -> Record:
    """-20..100 V at 1 Hz for 6 s, from 0 V."""
    t, u = signals.sine(6.0, FINER * rate, frequency=1.0, low=-20.0, high=100.0, phase=float(np.arcsin(-2 / 3)))
    return Actuator().record(t, u, seed=1, every=FINER, name="stage-sine")


def sweep(rate: float = 250.0) -> Record:
    """Twelve cycles from 0 V, amplitude falling from 100 to 10 V: nested minor loops."""
    t, u = signals.amplitude_sweep(
        FINER * rate, frequency=1.0, low=0.0, high=100.0, cycles=12, start=1.0, stop=0.1, anchor="low"
    )
    return Actuator().record(t, u, seed=2, every=FINER, name="stage-sweep")


def step(rate: float = 20.0) -> Record:
    """0 to 100 V just after 10 s, then 130 s of creep.

    The jump is right after a recorded sample, so a model that runs at the record's rate and applies the new voltage over the whole
    interval has the correct elapsed time.
    """
    t, u = signals.step(140.0, FINER * rate, at=10.0 + 1 / (FINER * rate), low=0.0, high=100.0)
    return Actuator().record(t, u, seed=3, every=FINER, name="stage-step")


def staircase(rate: float = 25.0) -> Record:
    """Eleven levels from 0 to 100 V and back, 4 s on each, ramps of 0.1 s between."""
    t, u = signals.staircase(FINER * rate, levels=11, hold=4.0, ramp=0.1, low=0.0, high=100.0)
    return Actuator().record(t, u, seed=4, every=FINER, name="stage-staircase")


RECORDS = {"stage_sine": sine, "stage_sweep": sweep, "stage_step": step, "stage_staircase": staircase}


def text(record: Record) -> str:
    """The record as CSV: columns t_s, u_V, y_um."""
    assert record.t is not None
    rows = (f"{t:.6g},{u:.5f},{y:.3f}" for t, u, y in zip(record.t, record.u, record.y, strict=True))
    return "\n".join(["t_s,u_V,y_um", *rows, ""])


def write(folder: Path) -> dict[str, str]:
    """Write all records and their checksums into a folder; returns SHA-256 by file name."""
    sums = {}
    for name, make in RECORDS.items():
        content = text(make()).encode()
        (folder / f"{name}.csv").write_bytes(content)
        sums[f"{name}.csv"] = hashlib.sha256(content).hexdigest()
    (folder / "checksums.json").write_text(json.dumps(sums, indent=2) + "\n")
    return sums


if __name__ == "__main__":
    hf.enable_x64()
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent
    for file, digest in write(target).items():
        print(f"{digest}  {file}")
