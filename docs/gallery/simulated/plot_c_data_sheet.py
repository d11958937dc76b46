"""
Permanent magnet: a data sheet from a magnetometer
==================================================

The moment of a small block of a simulated magnet over the applied field. Size and demagnetization turn the moment into the polarization
over the internal field, and the quantities of the data sheet follow with their errors, without a model.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.results.measured.magnetic_sample import Sample, prism_factor

MU0 = 4e-7 * np.pi
size = (2e-3, 2e-3, 4e-3)  # m, the field along the last

soft = lambda x: x / (1 + np.abs(x))  # approaches saturation as 1 / x
branch = lambda h: 0.3 * soft((h + 400e3) / 50e3) + 0.85 * np.tanh((h + 420e3) / 60e3)  # T over A/m
h = np.linspace(3e6, -3e6, 1501)
field, polarization = np.append(h, h[::-1]), np.append(branch(h), -branch(-h[::-1]))
applied = field + prism_factor(size) * polarization / MU0
moment = polarization / MU0 * np.prod(size) + np.random.default_rng(0).normal(0, 2e-5, field.size)
magnet = hf.Record(u=applied, y=moment, u_unit="A/m", y_unit="A*m2", u_name="Field", y_name="Moment", name="magnet")

sheet = hf.quantities(magnet, sample=Sample(size=size, size_stderr=1e-5))
print(sheet)

# %%
# The measured loop, and the polarization over the internal field from which the values are read.
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
axes[0].plot(applied / 1e3, 1e3 * moment)
axes[0].set(xlabel="applied field [kA/m]", ylabel="moment [mA m2]")
axes[1].plot(field / 1e3, polarization, label="J")
axes[1].plot(field / 1e3, polarization + MU0 * field, label="B")
rows = {row.name: row for row in sheet.rows["magnet"]}
axes[1].plot(-rows["HcJ"].value / 1e3, 0, "o", color="C0")
axes[1].plot([0, -rows["HcB"].value / 1e3], [rows["Br"].value, 0], "o", color="C1")
axes[1].set(xlabel="internal field [kA/m]", ylabel="polarization, induction [T]", xlim=(-900, 900), ylim=(-1.6, 1.6))
axes[1].legend(frameon=False)
