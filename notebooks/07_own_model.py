# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A model of your own, in one file
#
# A model is a class with two methods, `init` and `step`. Fits, samplers, inverses, profiles and the command line then take it by the name of its
# file. The example is a gear with backlash and a stiffness that hardens, which hystfit does not have.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()  # double precision, required by every fit
QUICK = os.environ.get("HYSTFIT_QUICK") == "1"  # a shorter run: fewer starts and draws
folder = Path("out") / "own_model"
folder.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The file
# Parameters are fields with bounds, unit and meaning. The state is one array. `c_part`, which is optional, is the same law in C.

# %%
source = '''"""A gear: backlash, then a spring that hardens."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hystfit as hf
from hystfit.models import AbstractHysteresis
from hystfit.models.shared.c_code import CPart

C = """
static void @f@_init(double *s, double u0) { s[0] = u0; }

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double p = fmax(u1 - @M@_GAP, fmin(u1 + @M@_GAP, s[0]));
    (void)u0;
    (void)dt;
    if (next)
        next[0] = p;
    return @M@_GAIN * p + @M@_HARDER * p * p * p + @M@_OFFSET;
}
"""


class Gear(AbstractHysteresis):
    """p <- max(u - gap, min(u + gap, p)),  y = gain p + harder p^3 + offset."""

    rate_independent: ClassVar[bool] = True

    gain: Float[Array, ""] = hf.param(1.0, bounds=(0.0, np.inf), unit="y/u", doc="stiffness at the center")
    harder: Float[Array, ""] = hf.param(0.01, bounds=(0.0, np.inf), unit="y/u^3", doc="hardening")
    gap: Float[Array, ""] = hf.param(0.1, bounds=(0.0, np.inf), unit="u", scale=0.1, doc="half width of the gap")
    offset: Float[Array, ""] = hf.param(0.0, unit="y", per_record=True, doc="constant")

    def init(self, u0):
        return jnp.reshape(u0, (1,))

    def step(self, state, u0, u1, dt):
        p = jnp.maximum(u1 - self.gap, jnp.minimum(u1 + self.gap, state[0]))
        return p[None], self.gain * p + self.harder * p**3 + self.offset

    def c_part(self):
        numbers = {name.upper(): getattr(self, name) for name in ("gain", "harder", "gap", "offset")}
        return CPart(C, 1, numbers)
'''
file = folder / "gear.py"
file.write_text(source);

# %% [markdown]
# `check_model` tests the laws that every model must obey: shapes, continuation, derivatives, rate independence.

# %%
from hystfit.models.registry import make_model
from hystfit.testing import check_model

gear = make_model(f"{file}:Gear")
check_model(gear, kinked=("gap",))

# %% [markdown]
# ## Fit
# A measured record, here simulated. Starting values are found by a Latin hypercube within the bounds and the scales of the data, since the
# class has no `start`.

# %%
t = np.arange(600) / 100
u = 3 * np.sin(2 * np.pi * t) * (0.3 + t / 8)
truth = {"gain": 2.0, "harder": 0.15, "gap": 0.4, "offset": 0.5}
y = type(gear)(**truth).free_run(u) + 0.02 * np.random.default_rng(0).standard_normal(u.size)
record = hf.Record(u=u, y=y, t=t, u_unit="mrad", y_unit="N m", u_name="angle", y_name="torque", name="gear")
result = hf.fit(gear, record, starts=2 if QUICK else 8)
result

# %%
figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.6), layout="constrained")
result.plot("loop", axes[0])
result.plot("residuals", axes[1])
plt.show()
for name, true in truth.items():
    print(f"{name:<8} {true:8.4f} {result[name].value:9.4f} ± {result[name].stderr:.4f}")

# %% [markdown]
# ## Sample
# The posterior under independent noise. An ensemble needs about 50 autocorrelation times a walker, and R-hat compares the walkers: a
# thousand steps of 32 walkers satisfy both, in the short run of this notebook too.

# %%
posterior = hf.sample(result, "emcee", noise="iid", walkers=32, draws=1000, seed=1)
print(posterior)

# %% [markdown]
# ## Invert
# The input that makes the output follow a reference, with a status for each sample. No method was written for it: hystfit solves the step.

# %%
reference = 4 * np.sin(2 * np.pi * t[:300])
inverse = hf.invert(result, reference)
print(inverse.counts())
print("largest tracking error:", np.max(np.abs(result.model.free_run(inverse.u) - reference)[5:]))

# %% [markdown]
# ## Export
# C99 of the model and its inverse. From the shell everything is the same, by the name of the file:
# `hystfit fit loop.csv --model gear.py:Gear --out fit`, `hystfit export fit --c board --trust`. A saved fit of a model of your own runs its file
# again, which `--trust` allows; without it, `export` refuses.

# %%
from hystfit.control import export_c

files = export_c(result, folder / "board", name="gear")
print("\n".join(path.name for path in files))
