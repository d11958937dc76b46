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
# # From first-order reversal curves to a Preisach density
#
# A magnet is saturated, the field is lowered to a reversal field, and the moment is measured while the field rises again. This is repeated with
# lower and lower reversal fields. Such curves determine the density of elementary loops: which coercivities occur, and how the loops interact.
#
# The measured set is of FeCo nanowires (pyforc, MIT license): 152 curves, 30 476 points. `hystfit datasets mag_forc_pyforc/FeCo` prints its
# address. It is read from the folder that the environment variable `HYSTFIT_DATA` names; without it, simulated curves are used.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit import signals
from hystfit.models.preisach import forc_diagram
from hystfit.results.preisach_plots import plot_forc_diagram
from hystfit.results.preisach_plots import plot_curves

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer curves and cells


def simulated() -> list[hf.Record]:
    """Reversal curves of a model with a known density."""
    hidden = hf.ParametricPreisach(
        saturation=0.8, coercivity=900.0, width=350.0, spread=500.0, slope=2e-5, levels=np.linspace(-4000, 4000, 41), initial="positive",
    )  # fmt: skip
    u, curve = signals.forc_protocol(curves=24, points=60, low=-4000.0, high=4000.0)
    y = hidden.preisach().free_run(u) + 0.003 * np.random.default_rng(1).standard_normal(u.size)
    make = lambda k: hf.Record(
        u=u[curve == k], y=y[curve == k], name=f"curve {k}", u_unit="Oe", y_unit="memu", u_name="field", y_name="moment"
    )
    return [make(k) for k in range(1, curve.max() + 1) if np.count_nonzero(curve == k) > 8]  # 0: the descending parts


try:
    curves = list(hf.datasets.load("mag_forc_pyforc/FeCo", download=False))
    print(f"{len(curves)} measured curves")
except hf.HystfitError as reason:
    curves = simulated()
    print(f"{len(curves)} simulated curves, because the measured ones were not found: {reason}")

# %% [markdown]
# ## The curves
# The reader splits the file into curves; its notes say what else it found, such as the calibration point before each curve.

# %%
for note in curves[-1].notes[:6]:
    print(" -", note)
print(hf.check(curves[:: 16 if QUICK else 4]).text()[:1200])

# %% [markdown]
# ## The FORC diagram
# The mixed second derivative of the moment, from local quadratic polynomials. It needs no model, but noise can look like structure in it. The
# smoothing factor is chosen by eye, as usual.

# %%
figure, axes = plt.subplots(1, 2, figsize=(10.4, 4.2), layout="constrained")
clean = [r.replace(u=r.u[r.used], y=r.y[r.used], weight=r.weight[r.used]) for r in curves]
for ax, factor in zip(axes, (2, 4)):
    plot_forc_diagram(forc_diagram(clean[:: 4 if QUICK else 1], smoothing=factor), ax)
    ax.set_title(f"smoothing factor {factor}")
plt.show()

# %% [markdown]
# ## The density as a model
# `preisach-forc` solves for a density that is nowhere negative, with a penalty on its second differences. We fit a part of the curves and predict the others.

# %%
step = 8 if QUICK else 4
train, held = curves[::step], [curve for k, curve in enumerate(curves) if k % step == step // 2]
fit = hf.fit(f"preisach-forc:n={24 if QUICK else 40}", train)
errors = [np.sqrt(np.mean((fit.predict(r) - r.y)[r.used] ** 2)) for r in held]
reach = max(np.ptp(r.y[r.used]) for r in curves)
print(f"{len(train)} curves fitted, {len(held)} held out: rms error {100 * np.sqrt(np.mean(np.square(errors))) / reach:.2f} % of the range")

figure, axes = plt.subplots(1, 2, figsize=(10.4, 4.2), layout="constrained")
plot_curves(held, [fit.predict(r) for r in held], axes[0], every=2 if QUICK else 4)
fit.plot("density", axes[1])
plt.show()

# %% [markdown]
# ## Mean and width
# Mean and standard deviation of the density over coercivity (half the distance between the two switching fields) and interaction field (their mean),
# weighted by the mass of each cell:

# %%
levels, masses = np.asarray(fit.model.levels), np.asarray(fit.model.masses())
middle = (levels[1:] + levels[:-1]) / 2
up, down = (middle[index] for index in np.tril_indices(fit.model.n))  # the order of the cells
for label, values in (("coercivity", (up - down) / 2), ("interaction", (up + down) / 2)):
    mean = np.average(values, weights=masses)
    width = np.sqrt(np.average((values - mean) ** 2, weights=masses))
    print(f"{label:<12} mean {mean:7.1f}   standard deviation {width:7.1f} {curves[0].u_unit}")

# %% [markdown]
# The density is a full model: it predicts any input, and has an inverse and C code. At the shell: `hystfit fit FILE --model preisach-forc --out fit`,
# or `preisach-forc-signed` where the diagram has negative regions; `hystfit check FILE --preisach` tests the two assumptions (wiping-out, congruency).
