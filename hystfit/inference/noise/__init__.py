"""Noise models: the residuals of a hysteresis model as a random process with a likelihood."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "ar1": ["Ar1"],
        "base": ["AbstractNoise", "ResidualScales"],
        "discrepancy": ["LoopDiscrepancy"],
        "ornstein_uhlenbeck": ["OrnsteinUhlenbeck"],
        "registry": ["NOISES"],
        "setting": ["Setting"],
        "student_t": ["StudentT"],
        "white": ["White"],
    },
)
