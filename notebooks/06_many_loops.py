# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Many loops: a folder of measurements in one call
#
# A series of measurements is a folder of files, and some of them are bad. We make such a folder (twelve specimens of a damper whose
# stiffness falls with temperature, one file cut off, one with a dead sensor), fit all files, look at those that need it, and relate the
# parameters to the temperature.

# %%
import os
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: shorter records
folder = Path("out") / "many_loops"
shutil.rmtree(folder, ignore_errors=True)
(folder / "loops").mkdir(parents=True)

# %%
temperatures = np.linspace(-10, 45, 12)
t = np.arange(300 if QUICK else 1200) / (100 if QUICK else 400)
u = 12 * np.sin(2 * np.pi * t) * (0.4 + 0.2 * np.floor(t))
rng = np.random.default_rng(7)
for temperature in temperatures:
    damper = hf.BoucWen(c=2.0 - 0.01 * temperature, mu=0.7, tau=0.35, rho=0.2)
    y = damper.free_run(u) + 0.02 * rng.standard_normal(u.size)
    table = np.column_stack([t, u, y])
    if temperature == temperatures[3]:
        table[:, 2] = 0.001 * rng.standard_normal(u.size)  # the force sensor was off
    if temperature == temperatures[8]:
        table = table[:3]  # the disk was full
    file = folder / "loops" / f"specimen_{temperature:+05.1f}C.csv"
    np.savetxt(file, table, delimiter=",", header="time_s,displacement_mm,force_kN", comments="", fmt="%.6g")
print("\n".join(path.name for path in sorted((folder / "loops").iterdir())[:4]), "...")

# %% [markdown]
# ## All of them
# One call, and at the shell `hystfit batch 'loops/*.csv' --model bouc-wen --out fits`, which writes a table, an overview page and reports.
# A file that cannot be fitted is a row with the reason; it does not stop the others.

# %%
fits = hf.fit_many("bouc-wen", str(folder / "loops" / "*.csv"), starts=1 if QUICK else 2, folder=folder / "run")
fits

# %% [markdown]
# ## Files that need attention

# %%
for row in fits.worst(2):
    print(f"{Path(row.name).name:<24} {row.status:<10} {row.reason.partition(';')[0]}")

# %% [markdown]
# ## The table
# `to_dataframe` and `to_xarray` convert it; `fits.save("fits.parquet")` writes it. The temperature is in the names of the files.

# %%
frame = fits.to_dataframe()
frame["temperature"] = [float(name[-10:].strip("_C.csv")) for name in frame["loop"]]
usable = frame[frame["status"] == "ok"]
usable[["temperature", "c", "c_stderr", "mu", "tau", "error_percent"]].round(4)

# %%
slope, offset = np.polyfit(usable["temperature"], usable["c"], 1, w=1 / usable["c_stderr"])
figure, ax = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
ax.errorbar(usable["temperature"], usable["c"], 2 * usable["c_stderr"], fmt="o", ms=4, lw=1, label="fits, two standard errors")
ax.plot(temperatures, offset + slope * temperatures, lw=0.9, label=f"{offset:.3f} {slope:+.4f} T  (true: 2 - 0.01 T)")
ax.set(xlabel="temperature [°C]", ylabel="stiffness c [kN/mm]")
ax.legend()
plt.show()

# %% [markdown]
# ## One of them in full
# `result` gives everything that `hystfit.fit` gives. The same call of `fit_many` with the same folder does not fit anything again.

# %%
name = fits.rows[0].name
result = fits.result(name)
figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.6), layout="constrained")
result.plot("loop", axes[0])
result.plot("residuals", axes[1])
plt.show()

# %% [markdown]
# Loops that *share* parameters are another question: `hf.fit` on a list of records fits them together, with an offset and an initial state
# for each record and everything else in common.

# %%
together = hf.fit("bouc-wen", [hf.read(row.name) for row in fits if row.usable][:3], starts=1)
print(f"three temperatures with one set of parameters: rms error {together.train.nrmse_percent:.2f} %; the first loop with its own {fits.rows[0].error_percent:.2f} %")
