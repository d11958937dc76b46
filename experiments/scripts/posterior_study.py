"""A posterior study: fit, draws, and what follows from the draws. The same at the shell: hystfit sample FIT --out OUT."""

import sys
from pathlib import Path

import numpy as np

import hystfit as hf

hf.enable_x64()
FILE = Path(__file__).parents[2] / "data" / "stage_sine.csv"
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/posterior_study")

record = hf.read(FILE).take(slice(None, None, 4))  # every fourth sample is enough here
result = hf.fit("bouc-wen", record, starts=1)
posterior = hf.sample(result, "emcee", noise="iid", walkers=16, draws=200, seed=1)  # "nuts" needs the extra "bayes"
print(posterior)

tau = posterior["tau"].ravel()
print(f"tau: {tau.mean():.5f} +- {tau.std():.5f} 1/V; standard error of the fit {result['tau'].stderr:.5f}")
OUT.mkdir(parents=True, exist_ok=True)
np.savetxt(OUT / "tau.csv", tau)
