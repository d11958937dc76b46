"""Level ends of loops under noise: limits of sensors and dead zones have two corners, saturation, backlash and plastic hinges have none."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.quality.faults import noise_rms
from hystfit.quality.flat_ends import flat_ends
from hystfit.quality.host_operators import play_positions
from tests.conftest import examined

N = 1200
U = 5 * np.sin(np.linspace(0, 8 * np.pi, N))
NOISE = 0.02 * np.random.default_rng(2).normal(size=N)
LAGGING = play_positions(U, np.array([0.5]))[:, 0]
PLATEAU = 4.1


def clipped(limit: float) -> np.ndarray:
    """An amplifier at its limits, and the noise of what measures it."""
    return np.clip(LAGGING, -limit, limit) + NOISE


def level_ends(y: np.ndarray) -> np.ndarray:
    """Level ends under noise that the samples show."""
    return flat_ends(U, y, noise_rms(y)[0])


def test_level_ends_are_those_beyond_the_limit_and_are_named() -> None:
    found = level_ends(clipped(PLATEAU))
    beyond = np.abs(LAGGING) > PLATEAU
    assert 0.2 < beyond.mean() < 0.4
    # Five times the noise from the corners, and its own largest values, the output is as near to the limit.
    apart = np.abs(np.abs(LAGGING) - PLATEAU) > 0.2
    np.testing.assert_array_equal(found[apart], beyond[apart])
    record = hf.Record(U, clipped(PLATEAU), u_unit="V", y_unit="V")
    assert has(examined(record).findings, Code.CLIPPED)
    assert has(hf.fit("prandtl-ishlinskii", record).notes, Code.CLIPPED)


def test_an_amplifier_may_be_at_its_limits_most_of_the_time() -> None:
    found = level_ends(np.clip(LAGGING, -2.7, 2.7) + 0.25 * NOISE)
    assert found.mean() > 0.6


@pytest.mark.parametrize("noise", [0.001, 0.0025, 0.006])
def test_approaches_to_saturation_have_no_corners_under_any_noise(noise: float) -> None:
    for device in (np.tanh(LAGGING), np.tanh(4 * LAGGING), np.tanh(3 * (U - 1.5 * np.sign(np.gradient(U))))):
        assert not level_ends(device + 2 * noise * np.resize(NOISE, N) / 0.02).any()


def test_a_dead_zone_at_one_end_looks_the_same() -> None:
    found = level_ends(np.maximum(LAGGING, -2.8) + NOISE)
    assert found.any()
    assert (LAGGING[found] < 0).all()


@pytest.mark.parametrize(
    "device",
    [
        LAGGING,
        4 * np.tanh(LAGGING),
        4 * np.tanh(2 * LAGGING),
        2 * LAGGING / np.sqrt(1 + LAGGING**2),
        U - LAGGING,  # a plastic hinge
        np.sign(U - np.sign(np.gradient(U))),  # a switch
        LAGGING**2,  # a butterfly
    ],
)
def test_devices_have_no_level_ends_between_corners(device: np.ndarray) -> None:
    assert not level_ends(device + NOISE).any()
