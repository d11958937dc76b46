"""The noise models by name."""

from hystfit.registry import Registry

_HERE = "hystfit.inference.noise"
NOISES = Registry(
    "noise model",
    "noise",
    f"{_HERE}.base:AbstractNoise",
    {
        "iid": f"{_HERE}.independent:White",
        "ou": f"{_HERE}.slow:OrnsteinUhlenbeck",
        "ar1": f"{_HERE}.slow:Ar1",
        "student-t": f"{_HERE}.independent:StudentT",
        "discrepancy": f"{_HERE}.repeating:LoopDiscrepancy",
    },
)
