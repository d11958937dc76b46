"""
Electric steel: symmetric Preisach plane
========================================

Centered B(H) loops of three amplitudes of M130-27s electric steel. The material has no preferred sign, so mirror cells of the Preisach
plane share one weight.

Data: ``mag_ja_bh/M130_27s``, R. Szewczyk, JAmodel, MIT license.
"""

import hystfit as hf

hf.enable_x64()
result = hf.fit("preisach-magnetic", hf.datasets.load("mag_ja_bh/M130_27s"))
result.plot("loop")
print(f"rms error {result.train.nrmse_percent:.2f} %")

# %%
# The fitted density over the thresholds. The data never switched the hatched cells.
result.plot("density")
