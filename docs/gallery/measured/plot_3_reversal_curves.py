"""
FeCo nanowires: reversal curves and their density
=================================================

First-order reversal curves from a vibrating-sample magnetometer. Every eighth of the 152 curves is fitted; the curves midway between
those are predicted.

Data: ``mag_forc_pyforc/FeCo``, P. Murray, pyforc, MIT license.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.models.preisach import fit_forc
from hystfit.results.preisach_plots import plot_curves, plot_density

hf.enable_x64()
curves = list(hf.datasets.load("mag_forc_pyforc/FeCo"))
fit, others = fit_forc(curves[::8], 40), curves[4::8]

figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
plot_curves(others, [fit.predict(curve.u) for curve in others], axes[0])
axes[0].set_title("curves that were not fitted")
plot_density(fit.model, axes[1], reach=fit.reach)

# %%
span = max(np.ptp(curve.y[curve.used]) for curve in curves)
errors = np.concatenate([(fit.predict(curve.u) - curve.y)[curve.used] for curve in others])
print(f"{len(others)} held-out curves: rms error {100 * np.sqrt(np.mean(errors**2)) / span:.2f} %")
