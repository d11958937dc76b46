"""
Staircase: the inverse with creep
=================================

The voltage that makes a simulated piezo actuator follow a staircase: the model is fitted to a sweep, and its inverse compensates
hysteresis and creep. The actuator is driven with this voltage and, for comparison, with the best constant gain.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf
from hystfit.stage import piezo

hf.enable_x64()
model = hf.fit("bouc-wen+log-creep", hf.datasets.load("stage-sweep"), starts=2)
actuator = piezo()
t, reference = hf.signals.staircase(100.0, levels=5, hold=2.0, ramp=0.1, low=0.0, high=9.0)

inverse = hf.invert(model, reference, 0.01, limits=(-20.0, 120.0))
drive = lambda u: np.asarray(hf.simulate(actuator, u, 0.01)[0])
plain = drive(10 * reference)
gain = 10 * float(plain @ reference / (plain @ plain))

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.plot(t, drive(inverse.u), label="inverse")
left.plot(t, drive(gain * reference), label="constant gain")
left.plot(t, reference, "k--", lw=0.8, label="reference")
left.set(xlabel="time [s]", ylabel="displacement [um]")
left.legend()
right.plot(t, 1e3 * (drive(inverse.u) - reference), label="inverse")
right.plot(t, 1e3 * (drive(gain * reference) - reference), label="constant gain")
right.set(xlabel="time [s]", ylabel="error [nm]")

# %%
print(inverse.counts())
