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
# # From reversal curves to a tracked trajectory
#
# A Preisach model describes a hysteretic device as a superposition of relays, each with its own pair of thresholds; the density of
# relays over the plane of thresholds defines the model. First-order reversal curves measure that density. We measure them on a
# device, estimate its density, plot the FORC diagram, test whether the device has the properties of a Preisach model, invert the
# model, and track a trajectory with the inverse, with and without feedback.
#
# The device is a *simulated* ferroelectric bender: voltage in, displacement out, 40 nm of sensor noise, a resonance at 16 Hz. Its
# density is known, so the results can be checked; nothing below uses it before the comparison.

# %%
import itertools
import os
from pathlib import Path

import equinox as eqx
import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.control import Controller, design, export_c, run_loop

from hystfit.results.preisach_plots import plot_forc_diagram
from hystfit.results.preisach_plots import plot_curves, plot_density
from hystfit.models.preisach import check_preisach, forc_diagram
from hystfit.models.preisach.properties import through

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer curves and cells
folder = Path("out") / "reversal_curves"
folder.mkdir(parents=True, exist_ok=True)

# %%
hidden = hf.ParametricPreisach(
    saturation=30.0, coercivity=32.0, width=14.0, spread=16.0, shift=6.0, slope=0.12, offset=42.0,
    levels=np.linspace(-100, 100, 31), initial="negative",
)  # fmt: skip
bender = hidden.preisach()  # one weight a cell
NOISE = 0.04  # um


def measure(u: np.ndarray, name: str, seed: int) -> hf.Record:
    """Sensor output for a slow input that starts at negative saturation."""
    y = bender.free_run(np.append(-100.0, u))[1:]
    noise = NOISE * np.random.default_rng(seed).standard_normal(u.size)
    return hf.Record(u=u, y=y + noise, name=name, u_name="voltage", y_name="displacement", u_unit="V", y_unit="um")


# %% [markdown]
# ## The curves
# `forc_protocol` goes to positive saturation, down to a reversal voltage and back up, with a lower reversal each time. It returns
# the curve that each sample belongs to; the descending parts are not used.

# %%
u, curve = hf.signals.forc_protocol(curves=40 if QUICK else 80, points=100 if QUICK else 200, low=-100.0, high=100.0)
whole = measure(u, "protocol", seed=1)
family = [
    hf.Record(
        u=u[curve == k], y=whole.y[curve == k], name=f"{u[curve == k][0]:.0f} V",
        u_name="voltage", y_name="displacement", u_unit="V", y_unit="um",
    )
    for k in range(1, curve.max() + 1) if np.count_nonzero(curve == k) > 3
]  # fmt: skip
print(len(family), "curves,", sum(len(r) for r in family), "samples")

# %% [markdown]
# ## The density
# Every other curve is fitted; the others test the prediction. The plane is divided into cells of uniform density, because with one
# relay per cell the output would jump. The levels are closer where the output is steep. The masses are non-negative and smooth,
# and the smoothing penalty is chosen by cross-validation over curves. At the shell use
# `hystfit fit FILE --by CURVE --model preisach-forc`; `hystfit check` reports whether a file contains such curves.

# %%
fit = hf.fit(f"preisach-forc:n={16 if QUICK else 32}", family[::2])
held = family[1::2]
error = np.concatenate([fit.predict(r) - r.y for r in held])
span = np.ptp(np.concatenate([r.y for r in family]))
print(f"fitted curves    {fit.train.nrmse_percent:.3f} % of the range")
print(f"the other curves {100 * np.sqrt(np.mean(error**2)) / span:.3f} %, largest {100 * np.abs(error).max() / span:.2f} %")
print(f"sensor noise     {100 * NOISE / span:.3f} %")
for note in fit.notes:
    print(" -", note)

# %% [markdown]
# The held-out curves are predicted to about the sensor noise. Below are the estimated and the true density. The data never switched
# the hatched cells: their values follow from the smoothing penalty alone.

# %%
figure, axes = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
plot_curves(held, [fit.predict(r) for r in held], axes[0], every=2 if QUICK else 4)
axes[0].set_title("held-out curves: measured, predicted")
fit.plot("density", axes[1])
axes[1].set_title("estimated density [um/V$^2$]")
plot_density(bender, axes[2])
axes[2].set_title("true density [um/V$^2$]")
plt.show()

# %% [markdown]
# ## The FORC diagram
# A FORC diagram shows the same density without a model: the mixed second derivative of the curves from local quadratic polynomials,
# with coercivity on the horizontal axis and interaction on the vertical one. The peak should be at a coercivity of 32 V and an
# interaction of 6 V.
#
# A small smoothing factor leaves noise in the diagram, a large one broadens the peak; the cells above need no such choice, because
# cross-validation sets their smoothing penalty.

# %%
figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
for ax, factor in zip(axes, (1, 3), strict=True):
    diagram = forc_diagram(family, smoothing=factor)
    plot_forc_diagram(diagram, ax)
    ax.set(xlim=(0, 90), ylim=(-70, 70), title=f"smoothing factor {factor}")
at = np.unravel_index(np.nanargmax(diagram.density), diagram.density.shape)
print(f"peak at a coercivity of {diagram.coercivity[at]:.0f} V and an interaction of {diagram.interaction[at]:.0f} V")
plt.show()

# %% [markdown]
# ## Is it a Preisach device?
# A device is described by a Preisach model if and only if it has two properties. *Wiping-out*: a larger extremum erases the effect
# of smaller ones, so a minor loop closes where it began. *Congruency*: minor loops between the same two voltages have the same
# shape, whatever the history. `check_preisach` (`hystfit check LOOP --preisach` at the shell) measures both on any record with nested
# loops, and how well a model describes states that depend on more and more reversals.
#
# For comparison: a Bouc-Wen law, which has no memory beyond its present state and is no Preisach device.

# %%
voltages = (-100, 40, -20, 40, -20, 80, -20, 40, -20, 100, -60, 60, -30, 30, 0, 90, -100)
nested = through(voltages, 80)
other = hf.BoucWen(c=0.6, mu=0.5, tau=0.02, rho=0.5)
records = [measure(nested, "bender", seed=2), hf.Record(u=nested, y=np.asarray(hf.simulate(other, nested)[0]), name="Bouc-Wen law")]
for record in records:
    print(record.name)
    print(check_preisach(record).text())

# %%
figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for ax, record in zip(axes, records, strict=True):
    ax.plot(record.u, record.y, lw=0.8)
    ax.set(xlabel="voltage [V]", ylabel="displacement [um]", title=record.name)
plt.show()

# %% [markdown]
# ## Speed
# The states of the relays depend on the input, but not on the weights. `free_run` therefore finds the distinct states that the input
# visits, computes what each adds to the output from a table of sums, and gives the same numbers as the scan over the samples.

# %%
y = fit.model.free_run(nested)
scan = np.asarray(hf.simulate(fit.model, nested)[0])
print(f"{nested.size} samples; the two forms differ by {np.abs(y - scan).max():.1e} um")

# %% [markdown]
# ## The inverse
# For a given displacement the inverse computes the voltage: the stack of extrema gives the interval, a quadratic equation the position
# in it. Every sample has a status. The reference below has nested loops. Where it exceeds the reach of the bender, the status says so
# and the inverse returns the nearest voltage; it is exact again as soon as the reference returns into reach.

# %%
def trajectory(extrema: tuple[float, ...], rate: float, leg: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Half cosines from extremum to extremum, each of `leg` seconds."""
    part = 0.5 * (1 - np.cos(np.pi * np.arange(1, round(leg * rate) + 1) / round(leg * rate)))
    pieces = [a + (b - a) * part for a, b in itertools.pairwise(extrema)]
    values = np.concatenate([extrema[:1], *pieces])
    return np.arange(values.size) / rate, values


EXTREMA = (0.0, 70.0, 20.0, 60.0, 35.0, 50.0, 5.0)  # um
t, wanted = trajectory(EXTREMA, 500.0)
found = hf.invert(fit.model, wanted, limits=(-100.0, 100.0))
print({name: count for name, count in found.counts().items() if count})
met = found.codes == 0  # at the very start the fitted model lies some nanometers above 0 um
print(f"model driven by the inverse: largest error {np.abs(found.y - wanted)[met].max() / np.ptp(wanted):.1e} of the range")
far = hf.invert(fit.model, trajectory((0.0, 70.0, 20.0, 95.0, 40.0, 60.0, 30.0), 500.0)[1], limits=(-100.0, 100.0))
print("a trajectory to 95 um:", {name: count for name, count in far.counts().items() if count})
for note in far.notes():
    print(" -", note)

# %%
figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
axes[0].plot(t, found.u)
axes[0].set(xlabel="time [s]", ylabel="voltage [V]", title="voltage of the inverse")
axes[1].plot(found.u, wanted, lw=0.8)
axes[1].set(xlabel="voltage [V]", ylabel="reference displacement [um]", title="nested loops of the reference")
plt.show()

# %% [markdown]
# ## Tracking
# Now the bender with its resonance, and a gain 8 % below that of the day when its curves were measured. Feed-forward alone (the
# inverse) suffers from that change, feedback alone from its finite gain; the combination has a smaller error than either. A PD and
# lag controller is designed from the resonance and a secant gain for a damping ratio of 0.5 and a static error of 1/16 at
# 5000 samples per second; `design` reports the resulting phase margin.

# %%
RATE, WEAKER = 5000.0, 0.92
plan = design(omega=100.0, zeta=0.02, gain=float(np.ptp(wanted) / np.ptp(found.u)), rate=RATE)
print(f"damping {plan.damping:.2f}, static error {100 * plan.static_error:.1f} %;", "; ".join(plan.notes))
weaker = eqx.tree_at(lambda m: (m.w, m.b, m.offset), bender, replace_fn=lambda value: WEAKER * value)
plant = hf.Series(weaker, hf.SecondOrder(omega=100.0, zeta=0.02))
time, reference = trajectory(EXTREMA, RATE)
ahead = np.interp(time, t, found.u)
controller = Controller.of(plan.controller, RATE)
common = {"limits": (-100.0, 100.0), "noise": NOISE, "u0": -100.0}
runs = {
    "feed-forward": run_loop(plant, reference, RATE, feedforward=ahead, **common),
    "feedback": run_loop(plant, reference, RATE, controller=controller, feedforward=np.full(time.size, -100.0), **common),
    "both": run_loop(plant, reference, RATE, feedforward=ahead, controller=controller, **common),
}
print(f"{'':<14}{'largest error [um]':>20}{'rms [um]':>12}")
for name, run in runs.items():
    print(f"{name:<14}{run.max_error():>20.2f}{run.rms_error():>12.2f}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
axes[0].plot(time, reference, "k", lw=2, label="reference")
for name, run in runs.items():
    axes[0].plot(time, run.y, "--", lw=1, label=name)
    axes[1].plot(time, run.error, lw=0.8, label=name)
axes[0].set(xlabel="time [s]", ylabel="displacement [um]")
axes[1].set(xlabel="time [s]", ylabel="error [um]")
for ax in axes:
    ax.legend()
plt.show()

# %% [markdown]
# ## C code for a controller
# The model and its inverse as one C99 file with static memory, no library beyond `math.h`, and one call per sample.

# %%
files = export_c(fit.model, folder, name="bender", limits=(-100.0, 100.0))
print([file.name for file in files])
print(files[0].read_text().split("#ifndef")[0])

# %% [markdown]
# ## A measured material
# Loops of three amplitudes of M130-27s electric steel (JAmodel by R. Szewczyk, MIT license; `hystfit datasets mag_ja_bh/M130_27s`
# prints address and SHA-256), read from the folder that `HYSTFIT_DATA` names; without them, simulated loops are used. A
# material has no preferred sign: mirror cells of the plane share one weight (`preisach-magnetic`). Each loop is predicted from a
# fit to the others.

# %%
def simulated_loops() -> list[hf.Record]:
    """Loops of three amplitudes of a material with a known density."""
    material = hf.ParametricPreisach(coercivity=60.0, width=45.0, spread=25.0, slope=3e-4, levels=np.linspace(-400, 400, 81))
    made = []
    for amplitude in (400.0, 240.0, 150.0):
        u = amplitude * np.sin(2 * np.pi * np.arange(0, 2, 0.005))
        y = np.asarray(hf.simulate(material, u)[0]) + np.random.default_rng(2).normal(0, 0.005, u.size)
        made.append(hf.Record(u=u, y=y, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name=f"{amplitude:.0f} A/m"))
    return made


try:
    loops = list(hf.datasets.load("mag_ja_bh/M130_27s", download=False))
    print(len(loops), "measured loops")
except hf.HystfitError as reason:
    loops = simulated_loops()
    print(len(loops), "simulated loops, because the measured ones were not found:", reason)
figure, axes = plt.subplots(1, len(loops), figsize=(4 * len(loops), 3.6), layout="constrained")
full = max(np.ptp(loop.y) for loop in loops)
for k, (loop, ax) in enumerate(zip(loops, axes)):
    if QUICK and k != 1:
        continue
    others = hf.fit("preisach-magnetic", [other for other in loops if other is not loop])
    error = others.metrics(loop).rmse
    others.plot("loop", ax, data=loop)
    ax.set_title(f"{loop.name}: {100 * error / full:.2f} % of full scale")
    print(f"{loop.name}: not fitted, predicted to {100 * error / full:.2f} % of the range of the largest loop")
plt.show()

# %% [markdown]
# The density of a set of measured reversal curves is the subject of the notebook "From first-order reversal curves to a Preisach
# density".
