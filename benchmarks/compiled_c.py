"""The exported C code of a model, compiled by gcc and called from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit.control import export_c

GCC = shutil.which("gcc") or shutil.which("cc")
LIMITS = (-2.0, 2.0)
LOOP = """
#include "model.c"
void run(long samples, const double *u, const double *dt, double *y)
{
    model h;
    long k;
    model_init(&h, u[0]);
    for (k = 0; k < samples; k++)
        y[k] = model_step(&h, u[k], dt[k]);
}
"""


def compiled(model: hf.AbstractHysteresis) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Output of the model from input and time steps, both of shape (T,), by its exported C code."""
    assert GCC is not None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_c(model, folder, name="model", limits=LIMITS)
        (folder / "run.c").write_text(LOOP)
        flags = ["-O3", "-march=native", "-shared", "-fPIC"]
        subprocess.run([GCC, *flags, "run.c", "-o", "run.so", "-lm"], cwd=folder, check=True)
        library = ctypes.CDLL(str(folder / "run.so"))
    numbers = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    library.run.argtypes = [ctypes.c_long, numbers, numbers, numbers]
    library.run.restype = None

    def run(u: np.ndarray, dt: np.ndarray) -> np.ndarray:
        y = np.empty_like(u)
        library.run(u.size, u, dt, y)
        return y

    return run
