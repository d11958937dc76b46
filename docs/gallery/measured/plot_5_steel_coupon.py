"""
Steel coupon: stops with cyclic hardening
=========================================

Cyclic stress and strain of an S355J2 coupon. Weighted stops describe kinematic hardening. Their weights change with the
accumulated strain path, which describes cyclic hardening. The model has no yield plateau, so the first loading has the largest errors.

Data: ``steel_resspylab/example_2``, A. de Castro e Sousa, RESSPyLab, MIT license.
"""

import hystfit as hf

hf.enable_x64()
result = hf.fit("prandtl-ishlinskii-hardening:plays=10:degree=1", hf.datasets.load("steel_resspylab/example_2"))
result.plot("loop")
print(f"rms error {result.train.nrmse_percent:.2f} %, largest {result.train.max_error_percent:.1f} %")

# %%
# Part of the record with the largest persistent error.
result.plot("worst")
