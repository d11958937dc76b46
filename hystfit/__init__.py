"""hystfit fits hysteresis models to measured loops, reports what the data determine, and inverts the fitted model.

The public names are listed in `__init__.pyi`. Each is imported at its first use, which keeps `import hystfit` fast.
"""

from hystfit.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
