"""The noise models by name."""

from hystfit.registry import Registry

_HERE = "hystfit.inference.noise"
NOISES = Registry(
    "noise model",
    "noise",
    f"{_HERE}.base:AbstractNoise",
    {
        "iid": f"{_HERE}.white:White",
        "ou": f"{_HERE}.ornstein_uhlenbeck:OrnsteinUhlenbeck",
        "ar1": f"{_HERE}.ar1:Ar1",
        "student-t": f"{_HERE}.student_t:StudentT",
        "discrepancy": f"{_HERE}.discrepancy:LoopDiscrepancy",
    },
)
