"""`hystfit completion`: completion of verbs and options by the tabulator key, from the command line itself."""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def completion(shell: Literal["bash", "zsh", "fish"], /, *, install: bool = False) -> int:
    """Print the script that completes verbs and options in a shell, or install it for this user.

    Args:
        shell: bash, zsh or fish.
        install: write the script where the shell looks for it, and load it at the start of the shell.
    """
    from hystfit.cli import app

    if not install:
        print(app.generate_completion(shell=shell))
        return 0
    place = app.install_completion(shell=shell)
    shown = f"~/{place.relative_to(Path.home())}" if place.is_relative_to(Path.home()) else str(place)
    print(f"Written to {shown}; open a new shell")
    return 0
