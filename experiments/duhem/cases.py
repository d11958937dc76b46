"""The surrogate records: the paper's parameters, with inputs chosen here."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

import hystfit as hf
from hystfit import signals
from hystfit.identify import Rls
from hystfit.models.shared.simulation import simulate

LOW, HIGH = (
    0.0,
    50.0,
)  # V; the paper does not give its range: within these limits its parameters give the loop of a piezo
ALPHA = 0.0874  # 1/V
ALPHA_F = np.array([-0.015, 0.006, 5.57e-6, -8.6e-8])  # um/V^(i+1)
G = np.array([0.053, -0.83e-4, 8.1e-6])  # um/V^(j+1)
PAPER_RLS = np.array([*ALPHA_F, ALPHA, *G])
PAPER_GC = np.array([-0.0149, 0.0061, 5.5649e-6, -8.6096e-8, 0.0870, 0.051, -0.83166e-4, 8.196e-6])
LABELS = ("αf0", "αf1", "αf2", "αf3", "α", "g0", "g1", "g2")
WAVES = ("sine", "decaying sine")
Q = 30.0  # of the paper's weights; its print has lost a zero, and 30 suits 0-60 V
ORDERS = np.array([0, 1, 2, 3, 0, 0, 1, 2])  # power of v in each column
WEIGHTS = {"1/q^i, the paper's": Q**-ORDERS, "1/q^(2i)": Q ** (-2.0 * ORDERS)}
SMALL_STEPS = {"Legendre polynomials, scaled": {}} | {
    f"powers, {name}": {"basis": "powers", "weights": weights} for name, weights in WEIGHTS.items()
}
DURATION, CYCLES, DECAY = 2.0, {"sine": 2, "decaying sine": 5}, 1.0  # s, -, 1/s


@dataclasses.dataclass(frozen=True)
class Case:
    """One surrogate record and its truth.

    Attributes:
        record: with noise.
        y: output without noise [um], shape (T,).
        model: the true model.
    """

    record: hf.Record
    y: np.ndarray
    model: hf.Duhem

    @property
    def span(self) -> float:
        """Range of the output [um]."""
        return float(np.ptp(self.y))

    def deviation(self, model: hf.Duhem | None) -> np.ndarray:
        """Simulation error of a model against the noise-free output [um], shape (T,); infinite where there is none."""
        if model is None:
            return np.full(self.y.shape, np.inf)
        deviation = np.asarray(simulate(model, self.record.u)[0]) - self.y
        return np.where(np.isfinite(deviation), deviation, np.inf)

    def error(self, model: hf.Duhem | None) -> float:
        """Largest simulation error of a model [um]; infinite without a valid model."""
        return float(np.max(np.abs(self.deviation(model))))

    def rms(self, model: hf.Duhem | None) -> float:
        """RMS simulation error of a model [um]; infinite without a valid model."""
        return float(np.sqrt(np.mean(self.deviation(model) ** 2)))

    def model_of(self, powers: np.ndarray) -> hf.Duhem:
        """The model of the paper's parameters, with the first output that fits the record best."""
        identifier = Rls.of(self.model, self.record, basis="powers")
        model = identifier.model(powers, self.record)
        assert model is not None
        return model


def truth(scheme: str = "midpoint", w0: float = 0.0) -> hf.Duhem:
    """The model with the RLS column of the table in the paper."""
    return hf.Duhem.from_powers(ALPHA, ALPHA_F / ALPHA, G, LOW, HIGH, w0=w0, scheme=scheme)


def drive(wave: str, count: int) -> np.ndarray:
    """Input [V], shape (count,): two periods from rest at 0 V, or a decaying sine about the center of the range."""
    rate = (count - 1) / DURATION
    options = {"duration": count / rate, "rate": rate, "low": LOW, "high": HIGH, "frequency": CYCLES[wave] / DURATION}
    if wave == "sine":
        return signals.sine(**options, phase=-np.pi / 2)[1]
    return signals.decaying_sine(**options, decay=DECAY)[1]


def case(wave: str, count: int = 2001, noise: float = 0.0, seed: int = 0, scheme: str = "midpoint") -> Case:
    """A surrogate record.

    Args:
        wave: one of `WAVES`.
        count: number of samples.
        noise: standard deviation of white noise [um].
        seed: of the noise.
        scheme: of the true model.
    """
    u = drive(wave, count)
    w0 = 0.0 if wave == "sine" else float(truth().curves(jnp.asarray(u[0]))[0])  # from the anhysteretic curve
    model = truth(scheme, w0)
    y = np.asarray(simulate(model, u)[0])
    noisy = y + noise * np.random.default_rng(seed).normal(size=count)
    t = np.linspace(0, DURATION, count)
    record = hf.Record(u=u, y=noisy, t=t, u_unit="V", y_unit="um", name=f"{wave}, N = {count}", source="simulated")
    return Case(record, y, model)


def near(values: np.ndarray, seed: int) -> np.ndarray:
    """Parameters with relative errors of up to 10 %, shape (p,)."""
    return values * (1 + np.random.default_rng(seed).uniform(-0.1, 0.1, values.size))
