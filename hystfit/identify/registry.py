"""The sequential identifiers by name."""

from hystfit.registry import Registry

IDENTIFIERS = Registry(
    "identifier",
    "method",
    "hystfit.identify.base:AbstractIdentifier",
    {
        "rls": "hystfit.identify.rls:Rls",
        "gradient-correction": "hystfit.identify.gradient_correction:GradientCorrection",
        "ukf": "hystfit.identify.ukf:Ukf",
    },
)
