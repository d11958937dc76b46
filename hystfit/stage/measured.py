"""Records of the whole stage: what was driven, what gauges and probes said, and the drive that a calibration needs."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.record import Record
from hystfit.outcome import Note
from hystfit.stage.kinematics import AXES, UNITS


@dataclasses.dataclass(frozen=True)
class Measured:
    """A record of the whole stage.

    Attributes:
        t: times [s], shape (T,).
        u: voltages that reached the actuators [V], shape (T, 3).
        extension: strain gauges on the actuators [um], shape (T, 3).
        pose: probes on the platform, x, y [um] and theta [mrad], shape (T, 3).
        notes: what the amplifiers cut off.
    """

    t: np.ndarray
    u: np.ndarray
    extension: np.ndarray
    pose: np.ndarray
    notes: tuple[Note, ...] = ()

    def columns(self) -> dict[str, np.ndarray]:
        """Columns by name, the unit after the last underscore, as files of records have them."""
        channels = {"t_s": self.t} | {f"u{k + 1}_V": self.u[:, k] for k in range(3)}
        channels |= {f"extension{k + 1}_um": self.extension[:, k] for k in range(3)}
        return channels | {f"{axis}_{UNITS[axis]}": self.pose[:, k] for k, axis in enumerate(AXES)}

    def record(self, axis: str, actuator: int) -> Record:
        """One axis against the voltage of one actuator (0, 1, 2)."""
        return Record(
            u=self.u[:, actuator],
            y=self.pose[:, AXES.index(axis)],
            t=self.t,
            u_unit="V",
            y_unit=UNITS[axis],
            u_name=f"voltage{actuator + 1}",
            y_name=axis,
            name=f"stage-{axis}",
            source="simulated stage",
            notes=self.notes,
        )


def in_turn(t: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One signal for each actuator after another, from which a Jacobian can be calibrated: times (3 T,), voltages (3 T, 3).

    An actuator rests on the signal's first value before its turn and on the last one after it.
    """
    length, step = t.size, float(np.median(np.diff(t)))
    volts = np.concatenate([np.full((3 * length, 1), u[0])] * 3, axis=1)
    for k in range(3):
        volts[k * length : (k + 1) * length, k] = u
        volts[(k + 1) * length :, k] = u[-1]
    return np.concatenate([t + k * (t[-1] - t[0] + step) for k in range(3)]), volts
