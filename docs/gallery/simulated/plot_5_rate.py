"""
Magnetorheological damper: a force that depends on the rate
===========================================================

A yielding damper with a force that saturates in the rate of the input. Terms are joined by ``+``; both are fitted together.
"""

import numpy as np

import hystfit as hf

hf.enable_x64()
truth = hf.Sum(hf.BoucWenForce(kappa_x=0.2, kappa_w=2.0, rho=0.6, sigma=0.6, n=1.0), hf.SaturatingRate(F=3.0, v0=40.0))
t = np.arange(0, 6, 0.005)
u = np.sin(2 * np.pi * (0.5 + 0.2 * t) * t) * np.interp(t, [0, 3, 6], [4.0, 12.0, 8.0])
y = np.asarray(hf.simulate(truth, u, 0.005)[0]) + np.random.default_rng(4).normal(0, 0.05, u.size)
data = hf.Record(u=u, y=y, t=t, u_unit="mm", y_unit="kN", name="damper")

result = hf.fit("bouc-wen-force+saturating-rate", data, starts=4)
result.plot("loop")

# %%
# Cross-validation shows how much the rate term improves the prediction.
print(hf.compare(data, ["bouc-wen-force", "bouc-wen-force+saturating-rate", "prandtl-ishlinskii-stop"]))
