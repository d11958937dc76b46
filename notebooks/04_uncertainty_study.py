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
# # How well are the parameters known? A study to copy
#
# From a CSV file to publishable error bars: residual analysis, parameters that the data determine, draws from the posterior, and the
# resulting uncertainty of the loop, of predictions and of the inverse. At the end: a poor experiment, and the input that improves it.
#
# To use it on your own data, change the cell that reads the file and the model; nothing else depends on the example.
#
# The record is *simulated* (a Bouc-Wen actuator, slow drift and white noise in the sensor), so the results can be compared with the
# truth. Nothing before the last table uses the truth.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer draws
folder = Path("out") / "uncertainty"
folder.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The file
# Eight cycles between 0 V and an amplitude that falls from 100 V to 20 V, then three more with other turning points, 800 samples. The
# sensor has 10 nm of white noise and 15 nm of slow noise with a correlation time of 25 samples (temperature, cables).

# %%
TRUTH = hf.BoucWen(c=0.2, mu=0.45, tau=0.06, rho=0.3, offset=0.1, scheme="exact")


def measure(u: np.ndarray, seed: int) -> np.ndarray:
    """Output of the true actuator with sensor noise [um]."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1 / 25)
    slow = np.empty(u.size)
    slow[0] = 0.015 * rng.normal()
    for k in range(1, u.size):
        slow[k] = keep * slow[k - 1] + 0.015 * np.sqrt(1 - keep**2) * rng.normal()
    return np.asarray(hf.simulate(TRUTH, u)[0]) + slow + 0.010 * rng.normal(size=u.size)


t = np.arange(800) / 100.0
top = np.interp(t, [0, 5.5, 6, 8], [100, 20, 90, 60])
low = np.interp(t, [0, 5.5, 6, 8], [0, 0, 25, 10])
u = low + (top - low) * 0.5 * (1 - np.cos(2 * np.pi * 1.4 * t))
file = folder / "loop.csv"
np.savetxt(file, np.column_stack([t, u, measure(u, 1)]), fmt="%.5f", delimiter=",", header="t_s,u_V,y_um", comments="")

# %%
record = hf.read_csv(file)
fitted, held_back = record.window(0, 6.0), record.window(6.0, None)
MODEL = hf.BoucWen(scheme="exact")  # the exact step, valid at any sampling rate
print(hf.check(record, data_only=QUICK))

# %% [markdown]
# ## Fit and residuals
# Plain least-squares errors assume independent residuals. These residuals are autocorrelated, so 600 samples contain the information
# of far fewer. The report gives the correlation time of the residuals and the ratio of the corrected to the plain standard errors.

# %%
fit = hf.fit(MODEL, fitted)
print(fit)

# %%
plain = hf.fit(MODEL, fitted, noise="iid")
print(f"correlation time {fit.correlation_time:.1f} samples; standard errors {fit.error_ratio:.1f} times those for independent residuals")
for name in fit.free_names:
    print(f"{name:7} {fit[name].value:9.5f}   stderr {fit[name].stderr:.5f}   for independent residuals {plain[name].stderr:.5f}")

# %% [markdown]
# ## What the data determine
# The profile of a parameter is the likelihood of the best fit with that parameter fixed. If it falls on both sides, the parameter has
# confidence limits on both sides. Where a profile is curved or asymmetric, symmetric error bars mislead.

# %%
profiles = hf.profile(fit)
print(profiles)
profiles.plot()
plt.show()

# %% [markdown]
# ## Draws from the posterior
# The noise has parameters too: a slow and a white part. Sampling starts at the fit, in coordinates whitened by its curvature. Read the
# status first, then R-hat (1.01 at most) and the number of effective draws (400 at least) of each parameter.

# %%
posterior = hf.sample(fit, noise="ou", draws=100 if QUICK else 2000, chains=2 if QUICK else 4, seed=1)
print(posterior)

# %%
posterior.plot("corner")
plt.show()

# %%
posterior.plot("rank")
plt.show()

# %% [markdown]
# The derived quantities (area of the loop, coercive input, remanence, hysteresis in percent of the stroke) are computed for each draw,
# so they come with their uncertainty.
#
# ## Predictions
# Two bands over the held-out part: a narrow one for the model output, a wide one for measurements. About nine in ten samples should
# lie in the wide band.

# %%
lower, median, upper = posterior.bands(held_back, level=0.9, seed=2)
curve = posterior.bands(held_back, level=0.9, kind="credible", seed=2)
late = held_back.used  # the earlier part only sets the initial state
inside = np.mean(((held_back.y >= lower) & (held_back.y <= upper))[late])
figure, (top_axes, rest_axes) = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
top_axes.plot(held_back.t[late], held_back.y[late], "k.", ms=2, label="held out")
top_axes.plot(held_back.t[late], median[late], lw=1, label="median of the draws")
top_axes.set_ylabel("y [um]")
top_axes.legend()
rest_axes.fill_between(held_back.t[late], 1e3 * (lower - median)[late], 1e3 * (upper - median)[late], alpha=0.25, label="90 % of measurements")
rest_axes.fill_between(held_back.t[late], 1e3 * (curve[0] - median)[late], 1e3 * (curve[2] - median)[late], alpha=0.6, label="90 % of curves")
rest_axes.plot(held_back.t[late], 1e3 * (held_back.y - median)[late], "k.", ms=2)
rest_axes.set(xlabel="t [s]", ylabel="residual [nm]")
rest_axes.legend(loc="upper right")
plt.show()
print(f"{100 * inside:.1f} % of the held-out samples lie in the 90 % band")

# %% [markdown]
# ## The inverse
# The voltage that makes the output follow a reference, from the fit and from each draw; and the output error of the fit's voltage under
# each draw: the tracking error due to parameter uncertainty alone.

# %%
phase = np.arange(200) / 200
lowest, highest = float(np.quantile(fitted.y, 0.1)), float(np.quantile(fitted.y, 0.9))
reference = lowest + (highest - lowest) * 0.5 * (1 - np.cos(4 * np.pi * phase))
bands = hf.inverse_bands(posterior, reference, 0.01, count=50)
low_rms, high_rms = np.quantile(bands.rms, [0.05, 0.95])
print(f"tracking error due to parameter uncertainty: {1e3 * low_rms:.1f} to {1e3 * high_rms:.1f} nm rms (90 %)")
bands.plot()
plt.show()

# %% [markdown]
# ## A poor experiment, and a better one
# Three cycles of 10 V peak to peak at mid-range: the loop is nearly a line. The notes of the fit name the combinations of parameters
# that the data cannot separate, these parameters have no standard error, and `design` finds an input that determines them.


# %%
def error_text(error: float | None) -> str:
    """A standard error as text."""
    return "unknown" if error is None else f"{error:.2g}"


short_t = np.arange(300) / 100.0
small = 50 + 5 * np.sin(2 * np.pi * short_t)
poor = hf.fit(MODEL, hf.Record(u=small, y=measure(small, 3), t=short_t, u_unit="V", y_unit="um", t_unit="s"))
for note in poor.notes:
    print("-", note)
for name in poor.free_names:
    print(f"{name:7} {poor[name].value:10.4g} +- {error_text(poor[name].stderr)}")

# %%
better = hf.design(poor, low=0.0, high=100.0, samples=300, steps=20 if QUICK else 150)
print(better)

# %%
again = hf.fit(
    MODEL,
    [poor.data[0], hf.Record(u=better.best.u, y=measure(better.best.u, 4), t=short_t, u_unit="V", y_unit="um", name="designed")],
)
for name in again.free_names:
    print(f"{name:17} {again[name].value:10.4g} +- {error_text(again[name].stderr)}")

# %% [markdown]
# ## A measured damper, whose model is wrong
# Error bars assume that the model is right. Here is a measured loop where it is not: a magnetorheological damper on a shaking table
# (labcontrol, MIT license; `hystfit datasets mr_labcontrol/4.1` prints address and SHA-256), read from the folder that
# `HYSTFIT_DATA` names; without it, a damper with a saturating force is simulated, which the models below lack. Two models are
# fitted to the first 6 s, and each gives a value of `kappa_x`, the stiffness after yielding. Its standard error allows for autocorrelated
# residuals, but not for a wrong force law. Read the status before the errors: a stiffness from a model that is `rough` belongs to that
# model, and may not be that of the device.


# %%
def simulated_damper() -> hf.Record:
    """A damper whose force saturates with the rate, 9 s."""
    t = np.arange(900) / 100.0
    u = 10 * np.sin(2 * np.pi * 1.5 * t)
    device = hf.Sum(hf.BoucWenForce(kappa_x=0.02, kappa_w=1.0, rho=0.4, sigma=0.8, n=1.2), hf.SaturatingRate(F=4.0, v0=20.0))
    y = np.asarray(hf.simulate(device, u, np.full(t.size, 0.01))[0]) + 0.05 * np.random.default_rng(3).standard_normal(t.size)
    return hf.Record(u=u, y=y, t=t, u_unit="mm", y_unit="kN", t_unit="s", name="damper")


try:
    damper = hf.datasets.load("mr_labcontrol/4.1", download=False)
    print("measured:", damper)
except hf.HystfitError as reason:
    damper = simulated_damper()
    print(f"simulated, because the measured damper was not found: {reason}")
begin = float(damper.t[0])
first, rest = damper.window(begin, begin + 6), damper.window(begin + 6, None)
for name in ("bouc-wen-force", "bouc-wen-force+viscous"):
    wrong = hf.fit(name, first, starts=2 if QUICK else 8)
    stiffness = wrong["kappa_x"]
    print(f"{name:<24} {wrong.status}: fitted {wrong.train.nrmse_percent:.1f} %, the rest {wrong.metrics(rest).nrmse_percent:.1f} %")
    print(f"    kappa_x = {stiffness.value:.4g} +- {error_text(stiffness.stderr)} {stiffness.unit}, correlation time {wrong.correlation_time:.0f} samples")
    for note in wrong.notes[:3]:
        print("    -", note)

# %% [markdown]
# ## Against the truth
# Distance of the truth from the posterior mean in standard deviations; it should mostly be below two.

# %%
for row in posterior.table():
    if hasattr(TRUTH, row["name"]):
        true = float(getattr(TRUTH, row["name"]))
        print(f"{row['name']:7} true {true:8.4f}   mean {row['mean']:8.4f} +- {row['sd']:.4f}   {(row['mean'] - true) / row['sd']:+.1f} sd")
print(f"saved in {posterior.save(folder / 'posterior')}")
