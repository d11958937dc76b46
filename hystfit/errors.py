"""Errors that a user can act on: every message names what was found and the remedy."""

import importlib
import warnings
from typing import Any


class HystfitError(ValueError):
    """Base of all errors that hystfit raises on purpose; the command line turns one into exit status 2."""


class DataError(HystfitError):
    """A record or file cannot be used as it is."""


class ParameterError(HystfitError):
    """A parameter name, value, bound or unit is not usable."""


class ModelError(HystfitError):
    """A model is unknown, wrongly composed, or unsuitable for the data."""


class PrecisionError(HystfitError):
    """Double precision is off."""


class MissingExtraError(HystfitError):
    """An optional package is not installed."""

    def __init__(self, package: str, extra: str, purpose: str):
        super().__init__(f"{purpose} needs the package {package!r}: pip install 'hystfit-jax[{extra}]'")


def optional(package: str, extra: str, purpose: str) -> Any:
    """An optional package or a module of one, imported now, without its warnings: ArviZ announces changes once a day.

    `extra` is that of hystfit which installs it, and `purpose` what needs it, as the subject of a message.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtraError(package.partition(".")[0], extra, purpose) from error
