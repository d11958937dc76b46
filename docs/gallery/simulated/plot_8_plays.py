"""
Closed minor loops: weighted plays
==================================

A device with return-point memory: every minor loop closes. Weighted plays (Prandtl-Ishlinskii) have that memory too; their weights follow
from a convex solve, and their inverse is exact. A Bouc-Wen law, whose minor loops do not close, fits less well.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()
widths, weights = np.array([2.0, 6.0, 12.0, 20.0, 30.0]), np.array([0.03, 0.03, 0.02, 0.02, 0.01])
t = np.arange(0, 12, 0.01)
u = 50 * (1 - np.cos(2 * np.pi * t)) * np.linspace(1.0, 0.4, t.size) + 15 * np.sin(2 * np.pi * 3 * t) ** 2
plays = np.full(widths.shape, u[0])
path = []
for value in u:
    plays = np.clip(plays, value - widths, value + widths)
    path.append(0.05 * value + weights @ plays)
y = np.array(path) + np.random.default_rng(5).normal(0, 0.02, u.size)
data = hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name="nested loops")

figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for name, ax in zip(("prandtl-ishlinskii", "bouc-wen"), axes, strict=True):
    result = hf.fit(name, data, starts=4)
    result.plot("loop", ax)
    ax.set_title(f"{name}: rms error {result.train.nrmse_percent:.2f} %")
