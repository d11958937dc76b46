"""The sequential identifiers by name."""

from hystfit.registry import Registry

_HERE = "hystfit.identify"
IDENTIFIERS = Registry(
    "sequential identifier",
    "method",
    f"{_HERE}.base:AbstractIdentifier",
    {
        "rls": f"{_HERE}.rls:Rls",
        "gradient-correction": f"{_HERE}.gradient_correction:GradientCorrection",
        "ukf": f"{_HERE}.ukf:Ukf",
    },
)
