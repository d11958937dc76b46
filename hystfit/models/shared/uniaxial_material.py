"""A model as a `uniaxialMaterial` of OpenSees (see `hystfit.control.export`)."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class UniaxialMaterial:
    """The command that makes a material of OpenSees, without its tag."""

    kind: str  # name of the material
    arguments: tuple[float | int, ...]  # after the tag, in order
    # what the material lacks that the model has, in words that stand as comments: a constant force, a state before the record
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # what to know about its numerical solution

    def words(self, tag: int) -> tuple[str, ...]:
        """The words of the command: "uniaxialMaterial", kind, tag and arguments with eight digits."""
        shown = (str(value) if isinstance(value, int) else f"{value:.8g}" for value in self.arguments)
        return ("uniaxialMaterial", self.kind, str(tag), *shown)


def lost_constants(**values: float) -> tuple[str, ...]:
    """Comments on constants of a model that no material has, by name; none for those that are zero."""
    return tuple(f"{name} {value:.8g} is not in the material" for name, value in values.items() if value)


def bouc_wen_notes(n: float, zy: float) -> tuple[float, int, tuple[str, ...]]:
    """Tolerance and number of Newton steps of the Bouc-Wen materials, whose tolerance is absolute, and notes on them."""
    notes = ("n < 1: the Newton iteration of OpenSees may not converge where the force passes zero",) if n < 1 else ()
    return 1e-8 * zy, 100, notes
