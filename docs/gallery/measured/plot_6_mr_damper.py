"""
Magnetorheological damper: a yield force that lags the velocity
===============================================================

A damper on a shaking table. Its force depends on the displacement and on the velocity: ``damper`` is what the comparison chooses on the
first 6 s. These are fitted, and the rest is predicted.

Data: ``mr_labcontrol/4.1``, labcontrol, MIT license.
"""

import hystfit as hf

hf.enable_x64()
data = hf.datasets.load("mr_labcontrol/4.1")
fitted, later = data.window(0.0, 6.0), data.window(6.0, None)
result = hf.fit("damper", fitted)
result.plot("loop", data=later)
print(f"rms error {result.train.nrmse_percent:.2f} % fitted, {result.metrics(later).nrmse_percent:.2f} % held out")

# %%
# The samples with the largest errors.
result.plot("worst", data=later)
