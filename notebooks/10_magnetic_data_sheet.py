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
# # From the file of a magnetometer to a data sheet
#
# A hard magnet is measured as a moment over an applied field, in the units of the instrument. We read the numbers of its data sheet off
# the loop, with the corrections that lead there and the errors of each, fit Jiles-Atherton to a soft material, and write it for field
# programs.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.control import export_field_programs
from hystfit.errors import DataError
from hystfit.models.jiles_atherton import MU0
from hystfit.results.measured.magnetic_loop import MagneticLoop
from hystfit.results.measured.magnetic_sample import Sample

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: one start of the fit
folder = Path("out") / "magnet"
folder.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The file
# The measured file is read from the folder that the environment variable `HYSTFIT_DATA` names. If it is not there, a file of the same
# layout is written with a simulated magnet, and the numbers differ from those in the text.

# %%
SIZE = (1.98, 1.99, 2.70)  # mm
file = Path(os.environ.get("HYSTFIT_DATA", "")) / "vsm_magmeas" / "VSM_MH.DAT"
if not file.is_file():
    h = np.concatenate(
        [np.linspace(0, 140e3, 200), np.linspace(140e3, -140e3, 800), np.linspace(-140e3, 140e3, 800)]
    )  # Oe
    side = np.concatenate([np.zeros(200), np.full(800, 1.0), np.full(800, -1.0)])
    moment = 5.9 * (0.7 * np.tanh((h + 3.1e3 * side) / 3e3) + 0.3 * h / (np.abs(h) + 1.5e4))
    moment += np.random.default_rng(0).normal(0, 3e-4, h.size)
    rows = [f",{t},300,{field:.4f},{m:.8g},1e-4" for t, (field, m) in enumerate(zip(h, moment, strict=True))]
    head = [
        "[Header]",
        "TITLE,magnet",
        "BYAPP,VSM,2.0,2.0",
        "INFO,54.86,SAMPLE_MASS",
        f"INFO,({SIZE[0]}, {SIZE[1]}, {SIZE[2]}),SAMPLE_SIZE",
    ]
    names = "Comment,Time Stamp (sec),Temperature (K),Magnetic Field (Oe),Moment (emu),M. Std. Err. (emu)"
    file = folder / "magnet.dat"
    file.write_text("\n".join([*head, "[Data]", names, *rows, ""]), encoding="utf-8")
magnet = hf.Dataset.of(hf.read(file))[0]
magnet

# %% [markdown]
# ## The data sheet
# The size in the header gives the volume and the demagnetizing factor of the prism. Every correction is listed; those of drift, offset and
# slope are estimated, and applied only where asked for. Js carries the spread over four laws of approach, which is larger than all other
# errors: a data sheet should name its law.

# %%
sheet = hf.quantities(magnet, sample=Sample(size_stderr=0.01e-3))
sheet

# %%
raw = MagneticLoop.of(magnet, Sample(demagnetization=0.0))
loop = MagneticLoop.of(magnet, Sample())
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
for one, label in ((raw, "applied field"), (loop, "field inside the sample")):
    ax.plot(1e-3 * one.h, one.j, lw=1, label=label)
ax.set(xlabel="H [kA/m]", ylabel="J [T]", xlim=(-600, 600), title="Demagnetization shears the loop")
ax.legend()
plt.show()

# %% [markdown]
# ## A soft material
# Jiles-Atherton as published, and with pinning that falls with the magnetization. The loss tells more than the error of B.

# %%
try:
    ferrite = hf.Dataset.of(hf.datasets.load("mag_ja_bh/MnZn_ferrite", download=False))[-1]
except DataError:
    u = 80.0 * np.interp(np.arange(121), [0, 60, 120], [1, -1, 1])
    truth = hf.JilesAtherton(Ms=0.39, a=23.0, coupling=0.8, k=17.0, c=0.66, q=[2.4], slope=MU0)
    way = np.concatenate([np.linspace(0, 80, 60), u, u])
    y = np.asarray(hf.simulate(truth, way)[0])[-121:] + np.random.default_rng(0).normal(0, 3e-4, 121)
    ferrite = hf.Record(u, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name="simulated ferrite")
fits = {"as published": "jiles-atherton", "with falling pinning": "jiles-atherton:pinning=yes"}
results = {label: hf.fit(model, ferrite, starts=1 if QUICK else 8) for label, model in fits.items()}
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.plot(ferrite.u, ferrite.y, "k.", ms=3, label="measured")
for label, result in results.items():
    ax.plot(ferrite.u, result.predict(ferrite), lw=1, label=f"{label}: {result.train.nrmse_percent:.2f} %")
ax.set(xlabel="H [A/m]", ylabel="B [T]")
ax.legend()
plt.show()

# %%
for label, result in results.items():
    loss = next(one for one in result.quantities if one.name == "loop_area")
    print(f"{label}: loss {loss.value:.3g} J/m3, measured {loss.measured:.3g} J/m3")

# %% [markdown]
# ## For a field program
# Programs know the law as published. Each file states its units and its convention; for a term that a program lacks there is no file.

# %%
for program, written in export_field_programs(results["as published"], folder, name="ferrite").items():
    print(f"{program}: {written}")
