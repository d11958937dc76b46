"""The batch estimators by name."""

from hystfit.registry import Registry

_HERE = "hystfit.fitting"
ESTIMATORS = Registry(
    "estimator",
    "method",
    f"{_HERE}.estimate:AbstractEstimator",
    {
        "lm": f"{_HERE}.least_squares:LeastSquares",
        "dogleg": f"{_HERE}.least_squares:LeastSquares",
        "trf": f"{_HERE}.trust_region:TrustRegion",
        "lbfgsb": f"{_HERE}.bounded:BoundedDescent",
        "projected-gradient": f"{_HERE}.bounded:BoundedDescent",
        "convex": f"{_HERE}.convex:Convex",
        "preisach": "hystfit.models.preisach.solve:PreisachWeights",
    },
)
