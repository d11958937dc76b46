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
# # A wall that degrades and a damper that depends on the velocity
#
# A wall is pushed to and fro with growing displacement until it fails; a magnetorheological damper runs on a shaking table. We read
# cycles, backbone and failure off the wall without a model, fit models that lose stiffness and slip, predict the rest of the test from its
# first part, fit the damper, and write a yielding brace for OpenSees.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.control import export_opensees
from hystfit.errors import DataError

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: every eighth sample of the wall
folder = Path("out") / "walls"
folder.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The wall
# The measured record is read from the folder that the environment variable `HYSTFIT_DATA` names, or from the cache of an earlier
# download. If it is in neither, a simulated wall is used, and the numbers differ from those in the text.

# %%
try:
    wall = hf.datasets.load("struct_slotboom/trial2", download=False)
except DataError:
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(400) / 400) for a in (4, 4, 8, 8, 17, 17, 34, 34, 60, 60, 90, 90, 0)])
    truth = hf.BoucWenBaberNoori(kappa_x=0.2, kappa_w=55.0, zy=12.0, dnu=0.01, deta=0.08, zs=0.9, p=0.2, q=0.1, psi=0.3)
    noise = np.random.default_rng(0).normal(0, 0.3, u.size)
    wall = hf.Record(u=u, y=np.asarray(hf.simulate(truth, u)[0]) + noise, u_unit="mm", y_unit="kN", name="simulated wall")
if QUICK:
    wall = hf.Record(u=wall.u[::8], y=wall.y[::8], u_unit=wall.u_unit, y_unit=wall.y_unit, name=wall.name)
wall

# %% [markdown]
# ## Without a model
# Energy, secant stiffness and equivalent damping of each cycle carry standard errors from the noise. The backbone is that of the first
# cycle at each new peak, beside the last cycle that repeats it: the distance between the two is the cyclic loss of strength.

# %%
(loops,) = hf.force_loops(wall).values()
loops

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.plot(wall.u, wall.y, lw=0.5)
loops.plot(left)
right.plot([100 * one.stiffness_lost for one in loops.cycles], "o-")
right.set(xlabel="cycle", ylabel="stiffness lost [%]")
plt.show()

# %% [markdown]
# ## Models that degrade
# A plain Bouc-Wen element has no term for any of this. `bouc-wen-baber-noori` loses strength and stiffness with the energy that it absorbs
# and slips near zero force. In `self-similar-stops` the loop scales with the largest displacement so far; its weights follow from one
# linear solve.

# %%
fits = {name: hf.fit(name, wall) for name in ("bouc-wen-force", "bouc-wen-baber-noori", "self-similar-stops")}
for name, fit in fits.items():
    print(f"{name:24} {fit.train.nrmse_percent:5.2f} % of the range, {len(fit.free_names)} parameters, {fit.status}")

# %%
fig, axes = plt.subplots(1, 3, figsize=(12, 3.8), sharey=True, layout="constrained")
for ax, (name, fit) in zip(axes, fits.items(), strict=True):
    ax.plot(wall.u, wall.y, color="0.7", lw=0.8)
    ax.plot(wall.u, fit.model.free_run(wall.u), lw=0.6)
    ax.set(title=name, xlabel=f"displacement [{wall.u_unit}]")
axes[0].set_ylabel(f"force [{wall.y_unit}]")
plt.show()

# %% [markdown]
# ## Prediction of the rest of the test
# The first 60 % of the samples are fitted. The rest goes to larger displacements, and the fit says how far it extrapolates.

# %%
edge = round(0.6 * len(wall))
early, late = wall.window(None, edge), wall.window(edge, None)
for name in ("bouc-wen-baber-noori", "self-similar-stops"):
    fit = hf.fit(name, early)
    print(f"{name:24} in sample {fit.train.nrmse_percent:.2f} %, predicted {fit.metrics(late).nrmse_percent:.2f} % of the range")

# %% [markdown]
# ## The damper
# The force of a magnetorheological damper depends on the velocity, saturates, and differs between rising and falling speed. `damper` has a
# term for each; all but the lag of the velocity follow from one convex solve. It is fitted on 6 s and tested on the 9 s after.

# %%
try:
    damper = hf.datasets.load("mr_labcontrol/4.1", download=False)
except DataError:
    t = np.arange(0, 15, 0.01)
    u = 12 * np.sin(2 * np.pi * 0.85 * t) * np.minimum(t / 2, 1)
    v = np.gradient(u, t)
    force = 80 * np.tanh(v / 8) + 0.4 * v + 1.2 * u + np.random.default_rng(0).normal(0, 2.0, t.size)
    damper = hf.Record(u=u, y=force, t=t, u_unit="mm", y_unit="N", t_unit="s", name="simulated damper")
train, test = damper.window(None, 6.0), damper.window(6.0, 15.0)
for name in ("bouc-wen-force", "bouc-wen-force+viscous", "damper"):
    fit = hf.fit(name, train)
    print(f"{name:24} in sample {fit.train.nrmse_percent:.2f} %, predicted {fit.metrics(test).nrmse_percent:.2f} % of the range")

# %% [markdown]
# ## A line for OpenSees
# Elements that neither degrade nor slip have a material in OpenSees. The files state units and standard errors as comments.

# %%
u = np.concatenate([a * np.sin(2 * np.pi * np.arange(200) / 200) for a in (2.0, 5.0, 10.0)])
brace = hf.BoucWenForce(kappa_x=0.4, kappa_w=12.0, rho=0.5, sigma=0.6, n=1.5)
y = np.asarray(hf.simulate(brace, u)[0]) + np.random.default_rng(1).normal(0, 0.1, u.size)
fit = hf.fit("bouc-wen-force", hf.Record(u=u, y=y, u_unit="mm", y_unit="kN", name="brace"))
tcl, *_ = export_opensees(fit, folder, name="brace", tag=3)
print(tcl.read_text())
