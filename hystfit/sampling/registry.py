"""The samplers by name."""

from hystfit.registry import Registry

_HERE = "hystfit.sampling"
SAMPLERS = Registry(
    "sampler",
    "sampler",
    f"{_HERE}.base:AbstractSampler",
    {
        "independence": f"{_HERE}.independence:Independence",
        "nuts": f"{_HERE}.nuts:Nuts",
        "emcee": f"{_HERE}.ensemble:Ensemble",
        "nested": f"{_HERE}.nested:Nested",
        "weights": f"{_HERE}.weight_sampler:Weights",
    },
)
