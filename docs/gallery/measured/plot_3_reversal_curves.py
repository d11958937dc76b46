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
from hystfit.results.preisach_plots import plot_curves

hf.enable_x64()
curves = list(hf.datasets.load("mag_forc_pyforc/FeCo"))
fit, others = hf.fit("preisach-forc:n=40", curves[::8]), curves[4::8]

figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
plot_curves(others, [fit.predict(curve) for curve in others], axes[0])
axes[0].set_title("curves that were not fitted")
fit.plot("density", axes[1])

# %%
span = max(np.ptp(curve.y[curve.used]) for curve in curves)
errors = np.concatenate([(fit.predict(curve) - curve.y)[curve.used] for curve in others])
print(f"{len(others)} held-out curves: rms error {100 * np.sqrt(np.mean(errors**2)) / span:.2f} %")
