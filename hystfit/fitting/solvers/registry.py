"""The estimators by name, and which methods are sequential."""

from typing import Any

from hystfit.identify.registry import IDENTIFIERS
from hystfit.registry import Registry, class_from_file

_HERE = "hystfit.fitting.solvers"
ESTIMATORS = Registry(
    "estimator",
    "method",
    f"{_HERE}.estimate:AbstractEstimator",
    {
        "lm": f"{_HERE}.least_squares:LeastSquares",
        "dogleg": f"{_HERE}.least_squares:dogleg",
        "trf": f"{_HERE}.bounded:TrustRegion",
        "lbfgsb": f"{_HERE}.bounded:BoundedDescent",
        "convex": f"{_HERE}.convex:Convex",
        "preisach": f"{_HERE}.smooth_weights:SmoothWeights",
        "everett-table": f"{_HERE}.table_reading:TableReading",
        "switching": f"{_HERE}.switching_fit:Switching",
    },
)


def is_sequential(method: Any) -> bool:
    """Whether a method is a sequential identifier rather than a batch estimator; my_file.py:MyClass is loaded to see."""
    if isinstance(method, str) and ".py:" in method:
        path, _, name = method.rpartition(":")
        method = class_from_file(path, name, object)
    return method in IDENTIFIERS if isinstance(method, str) else IDENTIFIERS.holds(method)
