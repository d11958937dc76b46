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
# # A population of actuators: make it, fit it, compare it with the truth
#
# Piezo actuators of one type differ from each other. A controller that must work with all of them is designed for their spread, and the
# spread is measured by fitting every device. Here the devices are simulated, so their parameters are known: we see how much of the spread of the
# fits is real, and how much is the error of each fit.

# %%
import os
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit import signals
from hystfit.stage import Actuator

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer devices
folder = Path("out") / "population"
shutil.rmtree(folder, ignore_errors=True)  # of another form of this notebook
folder.mkdir(parents=True)

# %% [markdown]
# ## The devices
# The displacement per voltage `c` scatters by 3 %, the width of the loop `mu` by 2 %, and creep `gamma` by 10 %. At the shell, the same is
# `hystfit simulate stage --population 40 --spread c=0.03,mu=0.02,gamma=0.1 --signal amplitude-sweep --out devices.csv`: one file with a
# column `device`, and the true parameters beside.

# %%
devices = Actuator().population(6 if QUICK else 40, spread={"c": 0.03, "mu": 0.02, "gamma": 0.1}, seed=1)
t, u = signals.amplitude_sweep(cycles=3 if QUICK else 6, frequency=1.0, rate=100.0, low=0.0, high=100.0, anchor="low")
data = devices.records(t, u, seed=2)

figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.6), layout="constrained")
for record in data:
    left.plot(record.u, record.y, lw=0.5)
left.set(xlabel="voltage [V]", ylabel="displacement [µm]")
right.plot(devices.truth["c"], devices.truth["mu"], "o")
right.set(xlabel="c [µm/V]", ylabel="mu")
plt.show()

# %% [markdown]
# ## The fits
# `fit_many` fits each device on its own, in one compiled program. Finished fits are kept in a folder, so that the same call resumes after an
# interruption.

# %%
fits = hf.fit_many("bouc-wen+log-creep", data, starts=1 if QUICK else 2, folder=folder / "run")
fits

# %% [markdown]
# ## Compared with the truth
# The error of each estimate in units of its standard error: if the standard errors are right, these scatter by about one, and there is no
# trend over the true value.

# %%
names = ("c", "mu", "gamma[0]")
figure, axes = plt.subplots(1, 3, figsize=(12.0, 3.6), layout="constrained")
print(f"{'':<10}{'true spread':>14}{'spread of fits':>16}{'median stderr':>16}{'rms of errors in stderr':>26}")
for ax, name in zip(axes, names):
    truth = devices.truth[name]
    found = np.array([row.values[name] for row in fits])
    errors = np.array([row.stderr[name] for row in fits])
    pulls = (found - truth) / errors
    spread = lambda x: np.std(x, ddof=1) / np.mean(truth)
    print(f"{name:<10}{spread(truth):>14.2%}{spread(found):>16.2%}{np.median(errors) / truth.mean():>16.3%}{np.sqrt(np.mean(pulls**2)):>26.2f}")
    ax.errorbar(truth, found, errors, fmt="o", ms=3, lw=1)
    ax.axline((truth.mean(), truth.mean()), slope=1, color="gray", lw=0.8)
    ax.set(xlabel=f"true {name}", ylabel=f"estimated {name}")
    ax.locator_params(nbins=5)
plt.show()

# %% [markdown]
# The spread of the estimates equals the true spread, because the error of one fit is much smaller: what differs is the devices. Where
# the median standard error is not small beside the spread, subtract its square from the variance of the fits.
#
# ## One model for all?
# How well does the model of one device predict the others? Its error on each of them, beside the error of each device's own fit, in
# percent of the range:

# %%
first = fits.result(data[0].name)
own = np.array([row.error_percent for row in fits])
shared = np.array([first.metrics(record).nrmse_percent for record in data])
print(f"each device's own fit: median {np.median(own):.3f} %; the fit of device 1 on the others: median {np.median(shared[1:]):.2f} %, worst {shared.max():.2f} %")

# %% [markdown]
# The model of one device predicts the others to a few percent; a device's own model predicts it to the sensor noise. Open-loop control
# needs an inverse that was fitted to the same device. With one inverse for all devices, feedback has to correct these few percent.
