"""The version of hystfit, from which its metadata are made, and those of the packages that it uses."""

import functools
import importlib
import importlib.metadata

__version__ = "0.1.0"


@functools.cache  # the metadata of a package is a file that is parsed each time
def version_of(package: str) -> str | None:
    """Version of a package, also where it is only on the path, without the metadata of an installation; None where it states none."""
    if package == "hystfit":
        return __version__
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return getattr(importlib.import_module(package), "__version__", None)
