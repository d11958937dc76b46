"""The statistics: the problem that estimators solve, noise models, priors and residual analysis.

Enters: a `ParameterSpace`, a `Batch`, a noise model and priors, joined as a `Problem`.
Leaves: residuals and their derivatives, log densities, and what residuals tell about noise.
Open first: `problem.py`, then `objective.py`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["priors"])
