"""
Asymmetric piezo loop: generalized Bouc-Wen
===========================================

At high drive, the loop of a piezo actuator is curved and saturates earlier on one side. The generalized law has a skew, an exponent for the
sharpness of the knee, and a bent backbone.
"""

import numpy as np

import hystfit as hf

hf.enable_x64()
truth = hf.AsymmetricBoucWen(c=0.2, mu=0.5, tau=0.03, rho=0.5, skew=0.6, b=[0.8, 0.3], center=50.0, half=50.0)
t = np.arange(0, 8, 0.005)
u = 50 * (1 - np.cos(2 * np.pi * t)) * np.interp(t, [0, 2, 8], [1.0, 1.0, 0.2])
y = np.asarray(hf.simulate(truth, u)[0]) + np.random.default_rng(1).normal(0, 0.02, u.size)
data = hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name="asymmetric piezo")

result = hf.fit("bouc-wen-asymmetric", data, starts=4)
result.plot("loop")

# %%
for name in ("c", "mu", "tau", "rho", "skew"):
    parameter = result[name]
    print(f"{name:5} true {float(getattr(truth, name)):6.3f}   fitted {parameter.value:6.4f} +- {parameter.stderr:.4f}")
