"""Logs of thermostats: the output has two levels, and switches some samples before or after the thresholds that the model finds."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.data.two_levels import has_two_levels
from hystfit.models import Relay
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.quality.faults import saturated_samples

LOW, HIGH = 20.5, 22.5  # degC
NOISE = np.random.default_rng(4).normal(size=(2, 1200))


def logged(noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Temperature after each interval in which a heater was on or off, with the noise of its sensor, and the power in that interval."""
    warm, on, temperature, power = 20.0, True, [], []
    for k in range(NOISE.shape[1]):
        on = warm < LOW if not on else warm < HIGH
        warm += (35 - warm) / 180 if on else (8 - warm) / 300
        temperature.append(warm + noise * NOISE[0, k])
        power.append(on * (1500 + 3 * NOISE[1, k]))
    return np.array(temperature), np.array(power)


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_thermostat_is_a_relay_however_often_it_is_logged(noise: float) -> None:
    temperature, power = logged(noise)
    found = hf.fit("auto", hf.Record(temperature, power, u_unit="degC", y_unit="W"))
    assert isinstance(found.model, Relay)
    assert found.status is Status.OK
    assert has(found.notes, Code.MEASUREMENT_NOISE)
    assert float(found.model.up) == pytest.approx(HIGH, abs=0.1)
    assert float(found.model.down) == pytest.approx(LOW, abs=0.1)


def test_plays_are_no_other_family_for_a_switch_that_is_logged_seldom() -> None:
    """A temperature a minute, eight between the thresholds: each switch is logged a sample late, and values between the levels err less."""
    warm, on, temperature, state = 21.0, False, [], []
    for noise in 0.01 * NOISE[0, :600]:
        on = warm < LOW if not on else warm < LOW + 1
        warm += (0.12 if on else -0.08) + noise
        temperature.append(warm)
        state.append(float(on))
    found = hf.fit("auto", hf.Record(np.array(temperature), np.array(state)))
    assert isinstance(found.model, Relay)
    assert found.status is Status.OK
    assert not has(found.notes, Code.OTHER_FAMILY)


def test_a_switch_of_another_input_is_no_relay_of_this_one() -> None:
    """It switches at other times than the thresholds of this temperature would."""
    temperature, power = logged(0.03)
    found = hf.fit("relay", hf.Record(temperature, np.roll(power, 25)), noise="iid")
    assert found.status is not Status.OK


def test_a_heater_is_no_saturated_sensor() -> None:
    """Its power is 0 where it is off, and has noise where it is on."""
    temperature, power = logged(0.03)
    assert has_two_levels(power)
    assert not saturated_samples(temperature, power).any()
    assert not has_two_levels(np.tanh(5 * np.sin(np.linspace(0, 20, 400))))
