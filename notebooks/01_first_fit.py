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
# # From a laboratory's CSV to a fitted hysteresis model
#
# A piezo actuator is driven by a voltage, its displacement is measured. We read the file as the data logger left it, look
# at the data before fitting, fit a model, ask on data left out which model describes the actuator best, test it on a
# second record, and ask what would have been learned from a poorer experiment.
#
# The actuator is a *simulated* one, with 5 nm of sensor noise: its parameters are known, so that the answers can be
# checked. Nothing below uses them before the comparison with the truth.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()  # double precision, which every fit asks for
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer models and starting points
folder = Path("out") / "first_fit"
folder.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The file
# Twelve cycles between 0 V and an amplitude that falls from 100 V to 10 V. We write them the way a logger with a German
# locale does: a preamble, names and units in two rows, semicolons, decimal commas, an event marked in the middle, the output
# before the input, a channel that was never connected, and two samples at which the sensor gave nothing.


# %%
def write_as_a_logger(record: hf.Record, path: Path) -> None:
    """A record as text with semicolons, decimal commas, units, comments, an empty channel and two missing outputs."""
    number = lambda value, digits: f"{value:.{digits}f}".replace(".", ",")
    rows = [
        "# Datenlogger DL-4, Kanal 1-3",
        "# Start: 12.03.2024 14:07:31",
        "Zeit;Weg;Spannung;Reserve",
        "[s];[µm];[V];[-]",
    ]
    for k in range(len(record)):
        y = "NaN" if k in (700, 701) else number(record.y[k], 3)
        rows.append(f"{number(record.t[k], 3)};{y};{number(record.u[k], 5)};")
        if k == 1499:
            rows.append("# Marke: Tür geöffnet")
    path.write_bytes("\r\n".join([*rows, ""]).encode("latin-1"))


file = folder / "messung_07.csv"
write_as_a_logger(hf.datasets.load("stage-sweep"), file)
print("\n".join(file.read_text(encoding="latin-1").splitlines()[:7]))

# %% [markdown]
# `read_csv` finds out how the file is written and which column is what. It says what it found, guessed and left out;
# where a guess is wrong, `time=`, `input=` and `output=` take the columns' names or numbers.

# %%
data = hf.read_csv(file)
print(data)
for note in data.notes:
    print(" -", note)

# %% [markdown]
# ## Look first
# A picture, then `check`: sampling, noise, loops, drift, lag, and which models these data can determine at all.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.4), layout="constrained")
left.plot(data.t, data.u, lw=0.8)
left.set(xlabel="time [s]", ylabel="voltage [V]")
right.plot(data.u, data.y, lw=0.8)
right.set(xlabel="voltage [V]", ylabel="displacement [µm]")
plt.show()

# %%
print(hf.check(data))

# %% [markdown]
# Two things are worth keeping in mind. Many amplitudes were measured, which is what most models need. And the output still
# moves for a fraction of a sample after the voltage has turned back: something in the actuator takes time, perhaps creep.
#
# ## A first fit
# Bouc-Wen is the usual first model of a piezo actuator, five parameters in the normalized form
# $y = y_0 + c\,v - h$ with $\mathrm{d}h/\mathrm{d}v = \mu c - (\tau\,\mathrm{sgn}(\dot v)\,\mathrm{sgn}(h) + \rho\tau)\,|h|$.
# No starting values are needed: they are read off the data.

# %%
first = hf.fit("bouc-wen", data)
print(first)

# %%
figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.8), layout="constrained")
first.plot("loop", axes[0])
first.plot("residuals", axes[1])
plt.show()

# %% [markdown]
# An rms error of 0.2 % of the range, and in the left picture model and measurement are one line. Is that good? The sensor's
# noise is known from `check`; the residuals are several times as large, and they are not noise: they follow the
# cycles and stay correlated for about a whole one. The model lacks something. The standard errors were widened for this
# correlation (the verdict says by how much); had the residuals been taken for independent, they would have been too small
# by that factor.
#
# ## Which model?
# A smaller error on the samples that were fitted proves little, since every further parameter lowers it. `compare` leaves out
# five contiguous blocks in turn, fits the rest, and predicts the block: the input drives the model through it, its output is
# not seen. Beside Bouc-Wen we try weighted plays (Prandtl-Ishlinskii), and Bouc-Wen followed by logarithmic creep, because
# of what `check` said about time.

# %%
models = ["bouc-wen", "prandtl-ishlinskii", "bouc-wen+log-creep"]
if not QUICK:
    models += ["duhem", "preisach"]
comparison = hf.compare(data, models)
print(comparison)

# %% [markdown]
# With creep the error on blocks left out falls to about the noise, and is the same there as on the samples fitted: no sign
# of overfitting. The plays fail here for a reason that can be read off the data. At every return to 0 V from a peak no
# higher than the first, all plays are where they were at the return before (return-point memory), so that the model gives
# the same displacement each time. The measured one differs from return to return:

# %%
returns = np.flatnonzero((data.u == 0) & (data.t > 0))
for name in ("prandtl-ishlinskii", "bouc-wen+log-creep"):
    predicted = comparison.fits[name].predict(data)[returns]
    print(f"{name:<20}", " ".join(f"{value:5.2f}" for value in predicted), "µm")
print(f"{'measured':<20}", " ".join(f"{value:5.2f}" for value in data.y[returns]), "µm")

# %% [markdown]
# Duhem (in the full run) fits well and fails on the blocks: the first of them holds the only cycles above 84 V, and its polynomials
# do not extrapolate. An error on data left out judges the model and the experiment together.
#
# All this speaks about this simulated actuator, whose hysteresis *is* a Bouc-Wen law. Small loops of real actuators tend to
# close on themselves, and then plays or a Preisach model win: let the data left out decide, not habit.
#
# ## The better model

# %%
best = comparison.winner
print(best)

# %%
figure, axes = plt.subplots(1, 3, figsize=(12.8, 3.6), layout="constrained")
best.plot("series", axes[0])
best.plot("residuals", axes[1])
best.plot("autocorrelation", axes[2])
plt.show()

# %% [markdown]
# The residuals are as large as the sensor's noise and uncorrelated, so that the standard errors can be taken at face value. The
# actuator is simulated, and we may look the answer up.

# %%
truth = {"c": 0.1542, "mu": 0.45, "bouc_wen.tau": 0.01086, "rho": 0.00956 / 0.01086, "offset": 0.0, "gamma[0]": 0.0175}
print(f"{'':<14}{'truth':>10}{'with creep':>12}{'(est. - truth) / stderr':>26}{'without creep':>16}{'likewise':>10}")
for name, true in truth.items():
    p = best[name]
    line = f"{name:<14}{true:>10.5f}{p.value:>12.5f}{(p.value - true) / p.stderr:>26.1f}"
    if name != "gamma[0]":
        q = first[name.removeprefix("bouc_wen.")]
        line += f"{q.value:>16.5f}{(q.value - true) / q.stderr:>10.1f}"
    print(line)

# %% [markdown]
# Without creep in the model its effect went into the other parameters: an error of the model, which no amount of data
# averages out.
#
# ## A record that was never touched
# The same actuator on another day: a sine from -20 V to 100 V, which neither the fits nor the comparison have seen, and which
# leaves the range of voltages fitted. The result says so.

# %%
sine = hf.datasets.load("stage-sine")
print(best.extrapolates(sine))
for name in models:
    metrics = comparison.fits[name].metrics(sine)
    print(f"{name:<20} rms {metrics.nrmse_percent:6.3f} %   largest {metrics.max_error_percent:6.2f} % of the range")

figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.8), layout="constrained")
best.plot("loop", axes[0], data=sine)
best.plot("residuals", axes[1], data=sine)
plt.show()

# %% [markdown]
# ## What the data determine
# Suppose that only one amplitude had been measured, and only settled cycles of it, as is often done. That is the sine from
# its third second on (`window` lets the earlier samples drive the model without counting them). `check` warns before any fit:

# %%
settled = sine.window(2.0)
for name, record in (("one amplitude", settled), ("twelve amplitudes", data)):
    found = hf.check(record).verdict("bouc-wen-asymmetric")
    print(f"{name:<18} {found.verdict}: {'; '.join(found.reasons)}")

# %% [markdown]
# We fit the same model to both: the generalized Bouc-Wen with creep, whose exponent $n$, skew and bent backbone $b$ the
# actuator does not need ($n = 1$, the others 0), as one does not know beforehand.

# %%
model = "bouc-wen-asymmetric+log-creep"
one = hf.fit(model, settled, starts=1 if QUICK else 8)
many = hf.fit(model, data, starts=1 if QUICK else 8)
print(f"{'rms error [% of the range]':<28}{'on its own data':>18}{'on the other record':>22}")
print(f"{'fitted to one amplitude':<28}{one.train.nrmse_percent:>18.3f}{one.metrics(data).nrmse_percent:>22.3f}")
print(f"{'fitted to twelve':<28}{many.train.nrmse_percent:>18.3f}{many.metrics(sine).nrmse_percent:>22.3f}\n")
print(f"{'stderr':<28}{'one amplitude':>18}{'twelve amplitudes':>22}{'ratio':>8}")
for name in many.free_names:
    a, b = one[name].stderr, many[name].stderr
    known = a is not None and b is not None
    words = [("-" if value is None else f"{value:#.2g}") for value in (a, b)] + [f"{a / b:.0f}" if known else "-"]
    print(f"{name:<28}{words[0]:>18}{words[1]:>22}{words[2]:>8}")

# %% [markdown]
# On its own data either fit is as good as the sensor. But slope, rate of saturation, exponent and offset are tens of times
# less certain from one settled amplitude: a change of one can be made up for by the others, and only other amplitudes
# would show it. A good fit does not say that the parameters were determined. The experiment decides that, and sweeping the
# amplitude costs nothing.
#
# Here the model can make exactly what the actuator does, so that even the loosely determined fit predicts the sweep well. With
# a model that is wrong in something the two faults multiply. With creep left out of the same model (in the full run of this
# notebook) one combination of parameters is lost altogether, which the verdict names, and the prediction with it:

# %%
if not QUICK:
    lost = hf.fit("bouc-wen-asymmetric", settled)
    print(f"{lost.train.nrmse_percent:.3f} % on its own data, {lost.metrics(data).nrmse_percent:.1f} % on the sweep")
    for note in lost.notes:
        print(" -", note)

# %% [markdown]
# ## Keep it
# A fit is saved with its data, errors and provenance, and comes back as the same object.

# %%
best.save(folder / "fit")
again = hf.load_fit(folder / "fit")
print(sorted(path.name for path in (folder / "fit").iterdir()))
print("same prediction:", np.array_equal(again.predict(sine), best.predict(sine)))

# %% [markdown]
# The same from the shell, with the report as one HTML page:
#
#     hystfit check messung_07.csv
#     hystfit compare messung_07.csv
#     hystfit fit messung_07.csv --model bouc-wen+log-creep --test other.csv --out fit
