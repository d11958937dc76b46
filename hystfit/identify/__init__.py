"""Sequential identifiers: recursive least squares, gradient correction, the unscented filter, and remedies against bias."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
