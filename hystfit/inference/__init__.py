"""The statistics: the problem that estimators solve, noise models, priors and residual analysis."""

from hystfit.inference import priors as priors
