"""
FORC diagram: coercivities and interactions of grains
=====================================================

First-order reversal curves of 30 000 simulated single-domain grains: coercivities of 35 +- 10 mT, and interaction fields of +- 8 mT. The
diagram and its profiles are read off the curves with standard errors; the shaded bands are two of them.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.models.preisach.forc_diagram import forc_diagram
from hystfit.models.preisach.forc_numbers import NUMBERS, forc_numbers
from hystfit.results.preisach_plots import plot_compared, plot_forc_diagram, plot_profiles
from hystfit.sampling.derived import sampled_density

hf.enable_x64()
rng = np.random.default_rng(0)
coercivity, interaction = np.abs(35 + 10 * rng.standard_normal(30_000)), 8 * rng.standard_normal(30_000)
curves = []
for reversal in np.linspace(78, -98, 60):
    field = np.arange(reversal, 100, 2.0)
    down = (interaction - coercivity)[:, None] > reversal  # grains that the way to the reversal has switched
    up = (interaction + coercivity)[:, None] < field
    moment = np.where(down & ~up, -1.0, 1.0).mean(axis=0) + rng.normal(0, 0.002, field.size)
    labels = {"u_unit": "mT", "y_unit": "uAm2", "u_name": "field", "y_name": "moment"}
    curves.append(hf.Record(u=field, y=moment, **labels, name=f"from {reversal:.1f} mT"))

diagram = forc_diagram(curves, smoothing=3, repeats=24)
units = {"u": "mT", "y": "uAm2"}
plot_forc_diagram(diagram, units=units)

# %%
numbers = forc_numbers(diagram)
figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
plot_profiles(numbers, axes, units=units)
for name in ("peak_coercivity", "median_coercivity", "coercivity_width", "interaction_width"):
    print(f"{NUMBERS[name][0]}: {numbers.values[name]:.2f} +- {numbers.stderr[name]:.2f} mT")

# %%
# Local quadratic regression smooths over one window, here 7 x 7 points. The smoothness of a Preisach density follows from the curves,
# and the posterior of its weights gives each number a posterior standard deviation. The shaded bands are two standard deviations.
sampled = sampled_density(hf.sample(hf.fit("preisach-forc:n=16", curves)))
figure = plt.figure(figsize=(11, 8.4), layout="constrained")
plot_compared({"local quadratic regression": diagram, "posterior of a Preisach density": sampled}, figure, units=units)
credible = forc_numbers(sampled)
for name in ("median_coercivity", "coercivity_width", "interaction_width"):
    print(f"{NUMBERS[name][0]}: {credible.values[name]:.2f} +- {credible.stderr[name]:.2f} mT")
