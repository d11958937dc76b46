"""The major loop and the remanence curve that first-order reversal curves contain, and the field's numbers of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.quality.reversal_curves import ReversalFamily, at_inputs
from hystfit.results.measured.loop_values import LoopValues, quantities


@dataclasses.dataclass(frozen=True)
class ForcLoop:
    """What reversal curves say without a density."""

    loop: Record  # from saturation along the first curve, the reversal points and the last curve: the major loop
    quantities: LoopValues  # of the loop
    # reversal, remanence: reversal fields of the curves that pass zero field from the other side [u], and their outputs there [y]
    reversal: np.ndarray
    remanence: np.ndarray
    # the field from which the remanence is half way between those of both saturations [u]; None without one
    remanent_coercivity: float | None

    def value(self, name: str) -> float | None:
        """A quantity of the loop by name; None where it has none."""
        return next((one.value for one in self.quantities.rows[self.loop.name] if one.name == name), None)

    @property
    def squareness(self) -> float | None:
        """Remanence over the output near the ends of the loop, Mrs/Ms."""
        remanence, saturation = self.value("remanence"), self.value("saturation")
        return remanence / saturation if remanence is not None and saturation else None

    @property
    def coercivity_ratio(self) -> float | None:
        """Remanent coercivity over coercivity, Hcr/Hc (Day, Fuller and Schmidt 1977)."""
        hc = self.value("coercive_input")
        return self.remanent_coercivity / hc if hc and self.remanent_coercivity else None

    def numbers(self) -> dict[str, tuple[str, float, float | None, str]]:
        """Label, value, standard error and unit of each number, by name; without those that the curves do not have."""
        quantities = {one.name: one for one in self.quantities.rows[self.loop.name]}
        labels = {
            "coercive_input": "coercivity Hc",
            "remanence": "remanence Mrs",
            "saturation": "saturation Ms (output near the ends)",
        }
        found = {
            name: (label, one.value, one.stderr, one.unit)
            for name, label in labels.items()
            if (one := quantities.get(name)) is not None
        }
        further = {
            "squareness": ("squareness Mrs/Ms", self.squareness, ""),
            "remanent_coercivity": ("remanent coercivity Hcr", self.remanent_coercivity, self.loop.u_unit),
            "coercivity_ratio": ("Hcr/Hc", self.coercivity_ratio, ""),
        }
        return found | {n: (label, v, None, unit) for n, (label, v, unit) in further.items() if v is not None}


def forc_loop(family: ReversalFamily) -> ForcLoop:
    """The loop and the remanence curve of a family of reversal curves."""
    first, *between = family.curves
    last = family.curves[-1]
    u = np.concatenate([first.u[::-1], [r.u[0] for r in between], last.u[1:]])
    y = np.concatenate([first.y[::-1], [r.y[0] for r in between], last.y[1:]])
    loop = dataclasses.replace(last, u=u, y=y, t=None, weight=None, name="major loop", notes=())
    crossing = [r for r in family.curves if r.u.min() <= 0 <= r.u.max() and (r.u[0] < 0) == family.rising]
    reversal = np.array([abs(r.u[0]) for r in crossing])
    remanence = np.array([float(at_inputs(r, np.zeros(1))[0]) for r in crossing])
    return ForcLoop(loop, quantities(Dataset((loop,))), reversal, remanence, _half_way(reversal, remanence))


def _half_way(reversal: np.ndarray, remanence: np.ndarray) -> float | None:
    """The reversal field at which the remanence has gone half way from its first to its last value [u]; None where it does not."""
    if reversal.size < 3 or remanence[0] * remanence[-1] >= 0:
        return None
    middle = 0.5 * (remanence[0] + remanence[-1])
    after = int(np.argmax((remanence - middle) * (remanence[0] - middle) <= 0))
    share = (remanence[after - 1] - middle) / (remanence[after - 1] - remanence[after])
    return float(reversal[after - 1] + share * (reversal[after] - reversal[after - 1]))
