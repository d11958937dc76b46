"""Quantities of a loop under changes of its record that the device does not know of: within their standard errors."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.results.measured.loop_values import quantities

from .conftest import examined


def _magnet(noise: float) -> hf.Record:
    """A loop of two tanh branches and a slope, from one tip to the other and back, as many samples as instruments take."""
    field = np.linspace(0.5, -0.5, 201)
    u = np.append(field, field[-2::-1])
    width = np.where(np.arange(u.size) < field.size, 0.02, -0.02)
    rng = np.random.default_rng(4)
    y = 1e-6 * np.tanh((u + width) / 0.05) + 3e-6 * u + noise * rng.standard_normal(u.size)
    return hf.Record(u=u, y=y, u_unit="T", y_unit="Am2", u_name="Field", y_name="Moment")


def _capacitor() -> hf.Record:
    """A ferroelectric loop whose polarization still rises behind the tip of a triangular voltage."""
    t = np.linspace(0.0, 1.0, 401)
    u = np.interp(t, [0.0, 0.25, 0.75, 1.0], [0.0, 5.0, -5.0, 0.0])
    late = np.interp(t - 0.012, [-0.25, 0.25, 0.75, 1.0], [-5.0, 5.0, -5.0, 0.0])
    side = np.where((t > 0.262) & (t <= 0.762), 1.5, -1.5)
    y = 12 * np.tanh((late + side) / 0.8) + 3.0 * late + 0.005 * np.random.default_rng(6).standard_normal(t.size)
    return hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="uC/cm2", u_name="Voltage", y_name="Polarization")


def _damper(hold: float = 0.0) -> hf.Record:
    """Three cycles of a viscous damper at 0.46 Hz, the displacement at rest at its lowest value before them."""
    t = np.arange(0.0, 3 / 0.46 + hold, 0.01)
    phase = 2 * np.pi * 0.46 * np.maximum(t - hold, 0.0)
    u, v = -20 * np.cos(phase), 20 * 2 * np.pi * 0.46 * np.sin(phase)
    rng = np.random.default_rng(2)
    y = 6.0 * v + 0.5 * u + 3.0 * rng.standard_normal(t.size)
    return hf.Record(u=u, y=y, t=t, u_unit="mm", y_unit="N", u_name="Displacement", y_name="Force")


RECORDS = {
    "magnet": _magnet(1e-9),
    "noisy magnet": _magnet(1e-8),
    "capacitor": _capacitor(),
    "damper": _damper(),
    "damper after a hold": _damper(2.0),
}


def _with(record: hf.Record, rows: slice | np.ndarray) -> hf.Record:
    t = None if record.t is None else record.t[rows]
    return record.replace(u=record.u[rows], y=record.y[rows], t=t, weight=None)


def _begun_elsewhere(record: hf.Record) -> hf.Record:
    first = int(0.37 * record.u.size)
    return _with(record, np.roll(np.arange(record.u.size), -first)) if record.t is None else record


CHANGES = {
    "every second sample": lambda record: _with(record, slice(None, None, 2)),
    "every third sample": lambda record: _with(record, slice(2, None, 3)),
    "begun elsewhere": _begun_elsewhere,
    "mirrored": lambda record: record.replace(u=-record.u, y=-record.y),
}
# Values that are those of single samples, or of one side of the loop.
_OF_SAMPLES = ("rising", "falling", "start", "end", "stroke", "switched_polarization")


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("change", CHANGES)
def test_values_agree_within_their_errors_after_a_change_that_the_device_does_not_know_of(name, change):
    record = RECORDS[name]
    before, after = (
        {one.name: one for one in quantities(r).rows[record.name]} for r in (record, CHANGES[change](record))
    )
    before = {key: one for key, one in before.items() if one.stderr and not key.endswith(_OF_SAMPLES)}
    compared = [key for key in before if key in after and after[key].stderr]
    assert len(compared) >= 3
    for key in compared:
        error = float(np.hypot(before[key].stderr, after[key].stderr))
        assert abs(abs(after[key].value) - abs(before[key].value)) <= 3.5 * error, key


@pytest.mark.parametrize("name", RECORDS)
def test_a_loop_that_would_give_off_energy_is_named(name):
    record = RECORDS[name]
    assert not has(examined(record).findings, Code.ENERGY_GAIN)
    backwards = record.replace(u=record.u[::-1], y=record.y[::-1], weight=None)
    assert has(examined(backwards).findings, Code.ENERGY_GAIN)
    exchanged = {"u_unit": record.y_unit, "y_unit": record.u_unit, "u_name": record.y_name, "y_name": record.u_name}
    assert not has(
        examined(record.replace(u=record.y, y=record.u, weight=None, **exchanged)).findings, Code.ENERGY_GAIN
    )
