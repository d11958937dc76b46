"""Identifiers through the registry, one from a user's file, and identifications as fits."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit import BoucWen, Duhem, simulate
from hystfit.data.record import Record
from hystfit.errors import ModelError, ParameterError
from hystfit.identify import IDENTIFIERS, AbstractIdentifier, Ukf, as_fit, identify
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.results.provenance import Stopwatch

OWN = '''
"""Stochastic gradient for a friction loop: y = k u + f sign(du)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit import param
from hystfit.identify import AbstractIdentifier, Info, Judgment
from hystfit.models import AbstractHysteresis
from hystfit.outcome import Status


class Friction(AbstractHysteresis):
    """Spring and dry friction."""

    rate_independent: ClassVar[bool] = True
    k: jnp.ndarray = param(1.0, unit="y/u", doc="stiffness")
    f: jnp.ndarray = param(0.0, unit="y", doc="friction")

    def start(self, records):
        return self

    def init(self, u0):
        return jnp.reshape(0.0 * u0, (1,))

    def step(self, state, u0, u1, dt):
        sign = jnp.where(u1 == u0, state[0], jnp.sign(u1 - u0))
        return sign[None], self.k * u1 + self.f * sign


class StochasticGradient(AbstractIdentifier):
    """Normalized least mean squares."""

    method: ClassVar[str] = "stochastic-gradient"
    solved: ClassVar[tuple[str, ...]] = ()
    start: jnp.ndarray
    scale: jnp.ndarray
    rate: float = eqx.field(static=True)

    @classmethod
    def of(cls, model, data, *, rate=0.5):
        size = max(float(np.max(np.abs(record.u))) for record in data)
        scale = jnp.array([1.0 / size, 1.0])
        return cls(jnp.array([model.k, model.f]) / scale, scale, rate)

    @property
    def names(self):
        return ("k", "f")

    def init(self):
        return self.start, jnp.zeros(2)

    def update(self, state, sample):
        theta, (u0, sign) = state
        sign = jnp.where(sample.first | (sample.u == u0), sign, jnp.sign(sample.u - u0))
        phi = jnp.stack([sample.u, sign]) * self.scale
        used = jnp.isfinite(sample.y) & ~sample.first
        error = jnp.where(used, sample.y - phi @ theta, 0.0)
        theta = theta + self.rate * error * phi / (0.1 + phi @ phi)
        return (theta, jnp.stack([sample.u, sign])), Info(theta, error, used)

    def physical(self, theta):
        return theta * np.asarray(self.scale)

    def model(self, theta, record):
        k, f = self.physical(theta)
        return Friction(k=k, f=f)

    def judge(self, run):
        return Judgment(Status.OK)
'''
K, F = 0.31, 2.4


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "stochastic_gradient.py"
    path.write_text(OWN)
    return path


def friction_record() -> Record:
    """The user's model by plain arithmetic, with noise."""
    t = np.arange(2000) / 200.0
    u = 50 * np.sin(2 * np.pi * t) * (1 - 0.5 * t / 10)
    y = K * u + F * np.sign(np.diff(u, prepend=u[0]))
    return Record(u=u, y=y + 0.01 * np.random.default_rng(0).normal(size=t.size), t=t, u_unit="V", y_unit="um")


def test_an_identifier_in_a_file_of_its_own_gives_a_fit_that_is_saved_and_reported(own, tmp_path):
    choice = f"{own}:StochasticGradient"
    identifier = IDENTIFIERS.find(choice)
    assert issubclass(identifier, AbstractIdentifier)
    start = sys.modules[identifier.__module__].Friction()
    identification = identify([friction_record()], choice, start, passes=2, rate=0.3)
    assert identification.status is Status.OK
    assert identification.history.shape == (4000, 2)
    np.testing.assert_allclose(identification.x, [K, F], rtol=5e-3)
    fit = as_fit(identification, 0, Stopwatch())
    assert (fit.method, fit.status, fit.usable) == ("stochastic-gradient", "ok", True)
    folder = fit.save(tmp_path / "fit")
    assert (folder / "report.html").is_file()
    again = hf.load_fit(folder)
    assert again.method == "stochastic-gradient"
    assert [p.value for p in again.parameters] == [p.value for p in fit.parameters]
    assert again.train == fit.train
    np.testing.assert_array_equal(again.predict(friction_record()), fit.predict(friction_record()))
    again.plot().figure.clear()


def test_settings_of_a_users_identifier_are_checked(own):
    with pytest.raises(ParameterError, match="no setting 'floor'; it has rate"):
        identify([friction_record()], f"{own}:StochasticGradient", floor=1.0)
    with pytest.raises(ParameterError, match="no class 'Other'"):
        IDENTIFIERS.find(f"{own}:Other")


@pytest.mark.parametrize("name", list(IDENTIFIERS))
def test_names_of_the_registry_are_those_in_results(name):
    assert IDENTIFIERS.find(name).method == name


# -- identifications as fits -------------------------------------------------------------------------------------------


def loop_records(count: int = 1) -> list[Record]:
    """Bouc-Wen loops of several amplitudes, each with its own offset."""
    t = np.arange(1200) / 200.0
    u = 40 + 60 * (0.55 + 0.45 * np.cos(2 * np.pi * t / 6.7)) * np.sin(2 * np.pi * t)
    truth = BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88, scheme="exact")
    y = np.asarray(simulate(truth, jnp.asarray(u))[0]) + 0.005 * np.random.default_rng(1).normal(size=t.size)
    return [Record(u=u, y=y + 0.5 * k, t=t, u_unit="V", y_unit="um", name=f"run{k}") for k in range(count)]


START = BoucWen(c=0.17, mu=0.45, tau=0.012, rho=0.7, scheme="exact")


def test_a_fit_holds_what_was_free_and_what_was_fixed():
    records = loop_records(2)
    identification = identify(records, "ukf", START, start="model", fix=("mu",))
    fit = as_fit(identification, 0, Stopwatch())
    assert fit.free_names == ("c", "tau", "rho", "offset@run0", "offset@run1")
    assert fit["mu"].fixed
    assert fit["mu"].value == 0.45
    np.testing.assert_allclose(identification.x, identification.history[-1], rtol=1e-12)
    assert fit["offset@run1"].value - fit["offset@run0"].value == pytest.approx(0.5, abs=0.02)
    np.testing.assert_array_equal(fit.predict(records[1]), identification.predict()[1])


def test_first_outputs_of_several_records_are_parameters_of_the_fit():
    identification = identify(loop_records(2), "rls")
    fit = as_fit(identification, 0, Stopwatch())
    values = [fit[f"w0@run{k}"].value for k in range(2)]
    assert values == [float(model.w0) for model in identification.models]
    assert values[0] != values[1]


def test_a_regression_of_another_model_is_refused():
    with pytest.raises(ModelError, match="Duhem"):
        identify(loop_records(), "rls", START)


def test_only_excludes_fix_and_free():
    record = loop_records()
    assert Ukf.of(START, record, start="model", only=("c", "offset")).names == ("c", "offset")
    for settings in ({"fix": {"mu": 0.4}}, {"free": ("tau",)}):
        with pytest.raises(ParameterError, match="only"):
            Ukf.of(START, record, start="model", only=("c",), **settings)


def test_the_default_model_is_that_of_the_paper():
    model = identify(loop_records()).model
    assert isinstance(model, Duhem)
    assert (model.f.size, model.g.size) == (4, 3)  # f of order 3, g of order 2


def test_an_identification_that_is_not_usable_gives_a_fit_that_is_not_usable():
    identification = identify(loop_records(), "gradient-correction", start="zero")
    assert identification.status is Status.NOT_CONVERGED
    fit = as_fit(identification, 0, Stopwatch())
    assert not fit.usable
    assert fit.status is identification.status
    assert fit.advice == identification.status.advice("identify")
    assert fit.notes[1 : 1 + len(identification.notes)] == identification.notes
    assert not has(fit.notes, Code.ROUGH_FIT)
