"""Loops on lines that fall, loops narrower than their curves, and loops of few samples: which way they run, and what may describe them."""

import numpy as np
import pytest

from hystfit import fit
from hystfit.data.circulation import circulation, trend
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.comparison.candidates import candidates
from hystfit.fitting.comparison.standings import leaves_noise
from hystfit.fitting.structure.model_structure import falls, on_falling_line
from hystfit.models.registry import make_model
from hystfit.outcome.note import Code, has

from .conftest import examined


def cycle(n: int) -> np.ndarray:
    """One triangle from the largest input down and back, 2 n - 1 samples."""
    return np.r_[np.linspace(1, -1, n), np.linspace(-1, 1, n)[1:]]


def film(u: np.ndarray, slope: float) -> np.ndarray:
    """A loop that saturates, of half width 0.1, on a line."""
    return np.tanh((u - 0.1 * np.sign(np.gradient(u))) / 0.05) + slope * u


def friction(u: np.ndarray) -> np.ndarray:
    """Force of Dahl, integrated step by step: dz = 8 du (1 - sign(du) z)."""
    z = np.zeros(u.size)
    for k, du in enumerate(np.diff(u)):
        z[k + 1] = z[k] + 8 * du * (1 - np.sign(du) * z[k])
    return z


def magnetic(u: np.ndarray, y: np.ndarray) -> Record:
    return Record(u=15000 * u, y=1e-4 * y, u_unit="Oe", y_unit="emu")


@pytest.mark.parametrize("slope", [0.0, -0.8, -3.0])
def test_a_loop_on_a_line_that_falls_rises(slope: float) -> None:
    u = cycle(200)
    assert trend(u, film(u, slope)) > 0.5
    assert circulation(u, film(u, slope)) > 0
    record = magnetic(u, film(u, slope))
    assert not falls(Dataset([record]))
    assert on_falling_line(Dataset([record])) is (slope < -1)
    assert not has(examined(record).findings, Code.FALLING)


@pytest.mark.parametrize("spring", [0.0, 0.3, 1.0, 3.0])
def test_a_force_of_the_other_sign_falls(spring: float) -> None:
    u = np.sin(np.linspace(0, 6 * np.pi, 900))
    force = spring * u + friction(u)
    np.testing.assert_allclose(trend(u, -force), -trend(u, force))
    assert trend(u, -force) < 0
    assert circulation(u, -force) == pytest.approx(circulation(u, force))
    assert circulation(u, -force) < 0


def test_models_of_a_film_have_a_line_beside_them() -> None:
    u = cycle(200)
    names = [candidates(Dataset([magnetic(u, film(u, slope))])).closed for slope in (0.5, -3.0)]
    assert "preisach-magnetic" in names[0]
    assert "preisach-magnetic+linear" in names[1]


def test_a_loop_of_four_samples_on_a_line_is_no_noise() -> None:
    # A film is measured every 1000 Oe, and reverses between two of them: a curve leaves four large errors, which seem white.
    u = cycle(31)
    y = 0.62 * np.tanh((u - 0.012 * np.sign(np.gradient(u))) / 0.0167) - 1.41 * u
    y += 0.006 * np.random.default_rng(4).standard_normal(u.size)
    curve = fit(make_model("curve"), magnetic(u, y))
    assert curve.train.rmse > 5 * 6e-7
    assert not leaves_noise(curve, 2)


def test_a_loop_much_narrower_than_its_curve_is_a_loop_where_its_samples_show_it() -> None:
    u = cycle(1000)
    paramagnet = np.tanh(3.5 * u)
    narrow = 0.034 * np.tanh((u - 0.003 * np.sign(np.gradient(u))) / 0.006)
    noise = 4e-6 * np.random.default_rng(7).standard_normal(u.size)
    assert not has(examined(magnetic(u, paramagnet + narrow + noise)).findings, Code.SINGLE_VALUED)
    assert has(examined(magnetic(u, paramagnet + noise)).findings, Code.SINGLE_VALUED)
    # Straight lines between samples that lie elsewhere on the way back enclose an area too.
    apart = np.r_[np.linspace(1, -1, 40), np.linspace(-1, 1, 57)[1:]]
    quiet = np.tanh(3.5 * apart) + 1e-8 * np.random.default_rng(8).standard_normal(apart.size)
    assert has(examined(magnetic(apart, quiet)).findings, Code.SINGLE_VALUED)
