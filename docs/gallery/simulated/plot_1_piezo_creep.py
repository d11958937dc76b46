"""
Piezo actuator: Bouc-Wen with creep
===================================

Twelve cycles of falling amplitude on a simulated piezo actuator (a bundled record). Logarithmic creep behind the hysteresis makes the
residuals white: nothing is left to describe.
"""

import hystfit as hf

hf.enable_x64()
data = hf.datasets.load("stage-sweep")
result = hf.fit("bouc-wen+log-creep", data, starts=2)
result.plot("loop")

# %%
# Values and standard errors; ``print(result)`` gives the whole report.
for name in result.free_names:
    print(f"{name:14} {result[name].value:10.6f} +- {result[name].stderr:.6f}")

# %%
# Residuals over time.
result.plot("residuals")
