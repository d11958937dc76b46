"""
U-shaped steel damper: weighted stops
=====================================

Force against displacement of a seismic damper in growing cycles. The first 60 % are fitted; the rest, with more than twice the
amplitude, is predicted.

Data: ``struct_slotboom/u-damper``, C. Slotboom, hysteresis, Apache-2.0 license.
"""

import hystfit as hf

hf.enable_x64()
data = hf.datasets.load("struct_slotboom/u-damper")
split = int(0.6 * len(data))
early, later = data.window(None, split), data.window(split, None)
result = hf.fit("prandtl-ishlinskii-stop", early)
result.plot("loop", data=later)
print(f"rms error {result.train.nrmse_percent:.2f} % fitted, {result.metrics(later).nrmse_percent:.2f} % held out")

# %%
# The prediction leaves the fitted range, which a note states.
print(result.extrapolation(later))
