"""One simulated piezo actuator with amplifier and sensor: hysteresis, creep, limits and noise.

The numbers of `piezo` are a calibrated surrogate of the Tokin AE0505D16 stack of Minase et al. (2010), whose identified
parameters were not published: 13 um over -20..100 V, a loop 2.4 um wide at 40 V, 0.0175 creep per decade.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.config import require_x64
from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.models import AbstractHysteresis, BoucWen, LogCreep, Series, simulate
from hystfit.outcome import Code
from hystfit.params.space import ParameterSpace


def piezo(
    *,
    c: float = 0.1542,
    mu: float = 0.45,
    tau: float = 0.01086,
    delta: float = 0.00956,
    gamma: float | tuple[float, ...] = 0.0175,
    span: float = 12.0,
    longest: float | None = None,
) -> Series:
    """Surrogate of one AE0505D16 stack: exact Bouc-Wen hysteresis followed by logarithmic creep.

    Args:
        c: displacement per voltage without hysteresis [um/V].
        mu: relative reduction of the slope at a reversal.
        tau: rate of saturation of the hysteresis [1/V].
        delta: shape of the tips of the loop [1/V], |delta| < tau.
        gamma: creep per decade of time; several numbers are coefficients of a polynomial in displacement / span.
        span: unit of the displacement in the polynomial [um].
        longest: time after a step up to which the creep is logarithmic [s]; 1000 s if None.

    Raises:
        ParameterError: a number outside its bounds.
    """
    coefficients = gamma if isinstance(gamma, tuple) else (gamma,)
    creep = (
        LogCreep(gamma=coefficients, span=span)
        if longest is None
        else LogCreep.spanning(0.1, longest, gamma=coefficients, span=span)
    )
    if not tau > 0:
        raise ParameterError(f"tau must be positive, got {tau}")
    model = Series(BoucWen(c=c, mu=mu, tau=tau, rho=delta / tau, scheme="exact"), creep)
    ParameterSpace.of(model)  # raises outside the bounds
    return model


@dataclasses.dataclass(frozen=True)
class Amplifier:
    """Voltage limits [V] of the driving amplifier (PI LVPZT).

    Raises:
        ParameterError: low is not below high.
    """

    low: float = -20.0
    high: float = 120.0

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ParameterError(f"an amplifier needs low < high, got {self.low} and {self.high} V")

    def drive(self, u: Any) -> jax.Array:
        """The voltage that reaches the actuator."""
        return jnp.clip(u, self.low, self.high)


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Standard deviation of white noise and resolution, both in the unit of the measured quantity; 0 is ideal.

    Raises:
        ParameterError: a negative number.
    """

    noise: float = 0.005
    resolution: float = 0.001

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.resolution >= 0):
            raise ParameterError(f"noise and resolution must not be negative, got {self.noise} and {self.resolution}")

    def read(self, y: Any, rng: np.random.Generator) -> np.ndarray:
        """A noisy, rounded reading of y, any shape."""
        reading = np.asarray(y, dtype=float) + self.noise * rng.standard_normal(np.shape(y))
        return np.round(reading / self.resolution) * self.resolution if self.resolution > 0 else reading


@dataclasses.dataclass(frozen=True)
class Actuator:
    """A stack with amplifier and displacement sensor: a source of records.

    Attributes:
        model: voltage [V] to displacement [um]; any hystfit model.
        amplifier, sensor: before and after it.
    """

    model: AbstractHysteresis = dataclasses.field(default_factory=piezo)
    amplifier: Amplifier = Amplifier()
    sensor: Sensor = Sensor()

    def displacement(self, t: Any, u: Any) -> np.ndarray:
        """Noise-free displacement [um] for commands u [V] at times t [s], shape (T,); at rest before the first."""
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        return np.asarray(simulate(self.model, self.amplifier.drive(u), jnp.diff(jnp.asarray(t), prepend=t[0]))[0])

    def record(self, t: Any, u: Any, *, seed: int, every: int = 1, name: str = "stage") -> Record:
        """A measurement. Its input is the voltage that reached the actuator.

        Args:
            t: times [s], shape (T,).
            u: commands [V], shape (T,).
            seed: of the sensor noise.
            every: the actuator is simulated at all samples, and every so many are recorded.
            name: of the record.

        Raises:
            DataError: shapes differ, or `every` is not positive.
        """
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if t.shape != u.shape or t.ndim != 1 or every < 1:
            raise DataError(f"t and u must have one shape (T,), every >= 1; got {t.shape}, {u.shape}, every {every}")
        y = self.displacement(t, u)[::every]
        reached = np.asarray(self.amplifier.drive(u))
        beyond = np.count_nonzero(reached != u)
        record = Record(
            u=reached[::every],
            y=self.sensor.read(y, np.random.default_rng(seed)),
            t=t[::every],
            u_unit="V",
            y_unit="um",
            u_name="voltage",
            y_name="displacement",
            name=name,
            source="simulated (surrogate of the AE0505D16)",
        )
        if not beyond:
            return record
        return record.noted(Code.PREPARED, f"{beyond} commands beyond the limits of the amplifier")


def population(model: Any, count: int, *, spread: Mapping[str, float], seed: int) -> Any:
    """`count` devices whose parameters scatter about those of a model: one model with a leading axis on every parameter.

    Simulate them with `jax.vmap`. Parameters with a lower bound scatter log-normally, the others normally.

    Args:
        model: any model.
        count: number of devices.
        spread: relative standard deviation by parameter name (fixed parameters too).
        seed: of the scatter.

    Raises:
        ParameterError: no device, an unknown name, a negative scatter, or one that leaves the bounds of a parameter.
    """
    require_x64()
    if count < 1 or any(not 0 <= size < np.inf for size in spread.values()):
        raise ParameterError(
            f"a population needs at least one device and a scatter of 0 or more; got {count} and {dict(spread)}"
        )
    space = ParameterSpace.of(model, free=list(spread))
    sizes = np.zeros(len(space))
    for name, size in spread.items():
        leaf, positions = space.find(name)
        sizes[[k for k, source in enumerate(space.sources) if source[0] == leaf and source[1] in positions]] = size
    center = space.vector(model)
    lower, upper = np.array([info.bounds for info in space.infos]).T
    noise = sizes * np.random.default_rng(seed).standard_normal((count, center.size))
    x = np.where(np.isfinite(lower), center * np.exp(noise), center * (1 + noise))
    if not ((x >= lower) & (x <= upper)).all():
        raise ParameterError(
            f"a scatter of {dict(spread)} leaves the bounds of {type(model).__name__}: make it smaller"
        )
    return jax.vmap(space.coordinates.assemble)(jnp.asarray(x))
