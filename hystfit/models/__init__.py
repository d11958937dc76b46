"""Hysteresis models, one file each: a new model is one file and one line in `__init__.pyi`; each is imported when it is first used."""

from hystfit.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
