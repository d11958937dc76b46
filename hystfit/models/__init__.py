"""Hysteresis models, one file each: a new model is one file and one line in `__init__.pyi`; each is imported when it is first used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
