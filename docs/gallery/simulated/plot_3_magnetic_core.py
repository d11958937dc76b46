"""
Magnetic core: symmetric Preisach plane
=======================================

Loops of four amplitudes of a simulated magnetic material. A material without a preferred direction of magnetization has a
symmetric plane: mirror cells share one weight, which halves the number of unknowns.
"""

import numpy as np

import hystfit as hf

hf.enable_x64()
truth = hf.ParametricPreisach(coercivity=60.0, width=45.0, spread=25.0, slope=3e-4, levels=np.linspace(-400, 400, 81))
t = np.arange(0, 8, 0.005)
u = np.sin(2 * np.pi * t) * np.repeat([400.0, 240.0, 150.0, 80.0], t.size // 4)
y = np.asarray(hf.simulate(truth, u)[0]) + np.random.default_rng(2).normal(0, 0.005, u.size)
data = hf.Record(u=u, y=y, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name="core")

result = hf.fit("preisach-magnetic", data)
result.plot("loop")

# %%
print(result.status, f"rms error {result.train.nrmse_percent:.2f} % of the range")
