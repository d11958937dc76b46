"""
Shock absorber: force against displacement and velocity
=======================================================

A simulated gas-charged damper whose valves resist rebound more than compression, with dry friction. It was moved before the record: its
seals are strained at the first sample. The model is linear in all of its forces, and one convex solve finds them.
"""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()
plain = hf.Damper()
truth = dataclasses.replace(
    plain,
    spring=np.array([60.0, 12.0, 0.0, 0.0]),
    viscous=250.0,
    bent=np.array([-60.0, 0.0, 90.0]),
    saturating=np.zeros(plain.saturating.shape),
    friction=np.where(np.arange(16) == 5, 900.0, 0.0),
    lagging=np.zeros(12),
    half=25.0,
    speed=400.0,
    tau=0.002,
    strain=1.0,
    offset=120.0,
)
t = np.arange(0, 8, 0.004)
u = 25 * np.sin(2 * np.pi * (0.3 * t + 0.15 * t**2)) * (0.5 + 0.5 * np.cos(2 * np.pi * t / 8) ** 2)
y = np.asarray(hf.simulate(truth, u, 0.004)[0]) + np.random.default_rng(1).normal(0, 4.0, u.size)
damper = hf.Record(u=u, y=y, t=t, u_unit="mm", y_unit="N", u_name="displacement", y_name="force", name="damper")

result = hf.fit("damper", damper.window(0.0, 5.0))
print(f"rms error on the other 3 s: {result.metrics(damper.window(5.0, None)).nrmse_percent:.2f} % of the range")
print(f"strain of the friction at the first sample: true {float(truth.strain):g}, found {float(result.model.strain):g}")
result.plot("loop")

# %%
# The same force over the velocity, measured and predicted.
velocity = np.gradient(u, t)
figure, ax = plt.subplots(figsize=(6, 4.2), layout="constrained")
ax.plot(velocity, y, ".", ms=2, color="0.6", label="measured")
ax.plot(velocity, result.predict(damper), lw=0.8, label="damper")
ax.set(xlabel="velocity [mm/s]", ylabel="force [N]")
ax.legend(frameon=False)
