"""
Piezo stack: asymmetric plays with lag and creep
================================================

Open-loop displacement of a piezo stack in a flexure: loops at 1 Hz that decay to rest and grow again, with holds. The first 27 s are
fitted. The rest of the record, which reaches beyond the fitted range, is predicted from its input alone.

Data: ``piezo_dbo/test``, yan9a, DiscreteBacklashOperator, MIT license.
"""

import hystfit as hf

hf.enable_x64()
data = hf.datasets.load("piezo_dbo/test")
fitted, later = data.window(None, 27.0), data.window(27.0, None)
result = hf.fit("lag+prandtl-ishlinskii-generalized+creep", fitted, starts=1)
result.plot("loop", data=later)
print(f"rms error {result.train.nrmse_percent:.2f} % fitted, {result.metrics(later).nrmse_percent:.2f} % held out")

# %%
# Error of the prediction over time.
result.plot("residuals", data=later)
