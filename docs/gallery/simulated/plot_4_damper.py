"""
Damper: force against displacement
==================================

Growing cycles of a simulated yielding damper. The output leads the input, so the models for it are stops, not plays, or the Bouc-Wen force
law, whose six parameters have a physical meaning.
"""

import numpy as np

import hystfit as hf

hf.enable_x64()
truth = hf.BoucWenForce(kappa_x=0.4, kappa_w=12.0, rho=0.5, sigma=0.6, n=1.5)
t = np.arange(0, 10, 0.01)
u = 20 * np.sin(2 * np.pi * 0.8 * t) * np.linspace(0.15, 1.0, t.size)
y = np.asarray(hf.simulate(truth, u)[0]) + np.random.default_rng(3).normal(0, 0.15, u.size)
data = hf.Record(u=u, y=y, t=t, u_unit="mm", y_unit="kN", name="damper")

result = hf.fit("bouc-wen-force", data)
result.plot("loop")

# %%
for name in ("kappa_x", "kappa_w", "rho", "sigma", "n"):
    parameter = result[name]
    print(f"{name:8} true {float(getattr(truth, name)):6.3f}   fitted {parameter.value:6.3f} +- {parameter.stderr:.3f}")
