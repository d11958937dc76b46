"""The statistics: the problem that estimators solve, noise models, priors and residual analysis."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["priors"])
