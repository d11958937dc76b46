"""The Preisach model from reversal curves: tables, densities, and the properties that the model presumes of a material."""

from hystfit.lazy import public_names
from hystfit.models.preisach.forc_diagram import forc_diagram as forc_diagram  # before its module takes the name

__getattr__, __dir__, __all__ = public_names(__name__)
