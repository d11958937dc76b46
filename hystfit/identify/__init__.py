"""Sequential identifiers: recursive least squares, gradient correction, the unscented filter, and remedies against bias.

Enters: a model, a `Dataset`, and the settings of an identifier, which updates its estimate with each sample.
Leaves: a `FitResult` and the paths of the estimates.
Open first: `base.py`, then one identifier, such as `rls.py`.
"""

from hystfit.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
