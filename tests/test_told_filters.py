"""What fits of a comparison tell of other models: values of filters, and relays behind the relaxation that plays need."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.comparison.compared_models import Row
from hystfit.fitting.comparison.standings import Standings
from hystfit.fitting.comparison.suggested import suggested
from hystfit.fitting.comparison.told_filters import with_filters_of
from hystfit.fitting.fit_model import solve_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.models.registry import make_model
from hystfit.models.series import Series
from hystfit.outcome import Status


def relaxing_relays(frequency: float, seed: int, samples: int = 160) -> hf.Record:
    """Relays with a Gaussian density of thresholds, of which a part follows with a time constant, by plain loops."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / (samples / 2) / frequency
    u = np.interp(2 * frequency * t % 2, [0, 0.5, 1.5, 2], [0, 1, -1, 0]) * np.where(frequency * t < 1, 1.0, 0.6)
    up, width = np.meshgrid(np.linspace(-1.6, 1.6, 81), np.linspace(0.02, 1.2, 31))
    up, down = (up + width / 2).ravel(), (up - width / 2).ravel()
    density = np.exp(-((0.5 * (up + down)) ** 2) / 1.5 - (up - down - 0.2) ** 2 / 0.3)
    density, state, slow, y = density / density.sum(), np.where(up + down > 0, -1.0, 1.0), 0.0, np.empty(samples)
    for k, field in enumerate(u):
        state = np.where(field >= up, 1.0, np.where(field <= down, -1.0, state))
        static = density @ state
        if k:
            slow += (1 - np.exp(-(t[k] - t[k - 1]) / 0.3)) * (static - slow)
        y[k] = 0.7 * static + 0.3 * slow
    return hf.Record(u, y + 2e-3 * rng.standard_normal(samples), t, name=f"{frequency:g} Hz")


@pytest.fixture(scope="module")
def relays() -> hf.Dataset:
    return hf.Dataset(tuple(relaxing_relays(f, k) for k, f in enumerate((0.05, 0.5, 5.0))))


@pytest.mark.parametrize(("white", "names"), [(False, ["preisach+relaxation"]), (True, [])])
def test_plays_with_a_relaxation_suggest_relays_with_it_unless_they_leave_noise(relays, white, names):
    standings = Standings(relays, "prediction", all_validated=False)
    name = "prandtl-ishlinskii+relaxation"
    fit = solve_model(name, relays, FitOptions()).unjudged
    standings.add(Row(name, name, 1.0, 1.0, status=Status.OK, leaves_noise=white), fit)
    assert suggested(standings) == names


@pytest.mark.slow  # 10 s: the relays are searched for their relaxation
def test_relays_are_tried_with_the_relaxation_that_plays_need(relays, monkeypatch):
    kinds = ("preisach", "bouc-wen", "prandtl-ishlinskii+relaxation")
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)
    found = hf.compare(relays, progress=lambda *_: None)
    errors = {row.asked: row.score for row in found.rows}
    assert found.rows[0].asked == "preisach+relaxation"
    assert errors["preisach+relaxation"] < 0.8 * errors["prandtl-ishlinskii+relaxation"]


def test_a_filter_gets_the_values_of_the_best_fit_that_has_one():
    lag, relays = hf.Lag(), make_model("preisach")
    best = Series(lag.replace(tau=0.7), make_model("prandtl-ishlinskii"))
    worse = Series(lag.replace(tau=0.1), make_model("prandtl-ishlinskii"))
    told = with_filters_of([best, worse], Series(lag, relays))
    assert float(told.parts[0].tau) == 0.7
    assert told.parts[1] is relays


def test_a_mirrored_input_is_no_filter():
    """The lag of a model of outputs that fall reaches other ones; what mirrors the input has no values to tell."""
    parts = make_model("negate+lag+prandtl-ishlinskii").parts
    told = with_filters_of([Series(parts[0], parts[1].replace(tau=0.7), parts[2])], make_model("negate+lag+preisach"))
    assert float(told.parts[1].tau) == 0.7


@pytest.mark.parametrize("name", ["preisach", "relaxation+preisach", "preisach+relaxation"])
def test_a_model_without_a_filter_of_that_kind_stays(name):
    model = make_model(name)
    assert with_filters_of([make_model("lag+prandtl-ishlinskii")], model) is model
