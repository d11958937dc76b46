"""
One amplitude: what the data cannot determine
=============================================

Three cycles of one small amplitude look like a line. The fit is perfect, and still useless for other amplitudes: the notes name the
parameters that the data cannot separate, and those have no standard error.
"""

import numpy as np

import hystfit as hf

hf.enable_x64()
truth = hf.BoucWen(c=0.2, mu=0.45, tau=0.06, rho=0.3, scheme="exact")
t = np.arange(300) / 100
u = 50 + 2 * np.sin(2 * np.pi * t)
y = np.asarray(hf.simulate(truth, u)[0]) + np.random.default_rng(3).normal(0, 0.01, u.size)
poor = hf.fit(hf.BoucWen(scheme="exact"), hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name="one amplitude"))
poor.plot("loop")

# %%
for note in poor.notes:
    print("-", note)

# %%
# `design` proposes an input that determines them.
better = hf.design(poor, low=0.0, high=100.0, samples=300, steps=30)
print(better)
