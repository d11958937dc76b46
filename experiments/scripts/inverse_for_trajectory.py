"""The voltage that makes an actuator follow a trajectory. The same at the shell: hystfit invert FIT trajectory.csv --out OUT."""

import sys
from pathlib import Path

import numpy as np

import hystfit as hf

hf.enable_x64()
FILE = Path(__file__).parents[2] / "data" / "stage_sweep.csv"
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/inverse_for_trajectory")

result = hf.fit("bouc-wen", hf.read(FILE), starts=1)

t = np.arange(400) / 100
wanted = 5 - 3 * np.cos(2 * np.pi * 0.5 * t) * np.exp(-t / 4)  # um
inverse = hf.invert(result, wanted, 0.01)
print("samples by status:", inverse.counts())

reached, _ = hf.simulate(result.model, inverse.u, 0.01)
error = np.asarray(reached) - wanted
reachable = np.array(inverse.status) == "ok"
largest = 1000 * np.abs(error[reachable]).max()
print(f"voltage {inverse.u.min():.1f} to {inverse.u.max():.1f} V, largest error of the model {largest:.2g} nm")
OUT.mkdir(parents=True, exist_ok=True)
np.savetxt(OUT / "voltage.csv", np.column_stack([t, inverse.u]), delimiter=",", header="t_s,u_V", comments="")
