"""Sequential identifiers: recursive least squares, gradient correction, the unscented filter, and remedies against bias."""

from hystfit.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
