"""
A map of 10 000 loops
=====================

Displacement loops of a simulated piezoelectric film, measured at 100 x 100 points. A defect lowers the slope and slows the saturation
around one point. `hystfit.fit_map` fits Bouc-Wen to every loop; the parameters are drawn beside the truth.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()
rows, columns = np.indices((100, 100))
defect = np.exp(-((rows - 65) ** 2 + (columns - 35) ** 2) / (2 * 8.0**2))
truth = {"c": 0.02 * (1 + 0.002 * columns) * (1 - 0.4 * defect), "tau": 0.15 * (1 + 0.8 * defect)}

t = np.arange(480) / 100
u = 10 * np.sin(2 * np.pi * t) * (0.4 + 0.6 * t / t[-1])
simulate = jax.vmap(lambda c, tau: hf.simulate(hf.BoucWen(c=c, mu=0.45, tau=tau, rho=0.4), u)[0])
y = np.asarray(jax.jit(simulate)(truth["c"].ravel(), truth["tau"].ravel())).reshape(100, 100, -1)
y = y + 1e-3 * np.random.default_rng(0).standard_normal(y.shape)

# %%
# Every loop has estimates, standard errors and a verdict.
found = hf.fit_map("bouc-wen", u, y, t, u_unit="V", y_unit="nm")
print(found)

# %%
# The truth, the estimate, and the difference in standard errors.
figure, axes = plt.subplots(2, 3, figsize=(9, 5.5), layout="constrained")
for row, name in zip(axes, truth, strict=True):
    pulls = (found[name] - truth[name]) / found.stderr[name]
    low, high = truth[name].min(), truth[name].max()
    for axis, picture, title in zip(row, (truth[name], found[name]), ("truth", "estimate"), strict=False):
        image = axis.imshow(picture, origin="lower", vmin=low, vmax=high)
        axis.set_title(f"{name}, {title}")
    figure.colorbar(image, ax=row[1], label=found.units[name])
    image = row[2].imshow(pulls, origin="lower", cmap="RdBu_r", vmin=-4, vmax=4)
    row[2].set_title(f"{name}, difference / standard error")
    figure.colorbar(image, ax=row[2])

# %%
# The standard error, the distribution, and loops far from most others.
found.plot("tau")
