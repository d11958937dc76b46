"""Populations: devices whose parameters scatter about those of a model, with the true parameters beside."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.models.shared.simulation import check_one_device
from hystfit.params.space import ParameterSpace
from hystfit.params.units import Scales

D = TypeVar("D")


def population(model: Any, count: int, *, spread: Mapping[str, float], seed: int) -> Any:
    """`count` devices whose parameters scatter about those of a model: one model with a leading axis on every parameter.

    Simulate them with `jax.vmap`. Parameters with a lower bound scatter log-normally, the others normally.

    Args:
        model: any model.
        count: number of devices.
        spread: relative standard deviation by parameter name (fixed parameters too).
        seed: of the scatter.

    Raises:
        ParameterError: no device, an unknown name, a negative scatter or seed, or a scatter that leaves the bounds of a parameter.
    """
    space, x = _scattered(model, count, spread, seed)
    return jax.vmap(space.coordinates.assemble)(jnp.asarray(x))


@verb
def _scattered(model: Any, count: int, spread: Mapping[str, float], seed: int) -> tuple[ParameterSpace, np.ndarray]:
    """Free parameters and those of the scatter, and their values, shape (count, n)."""
    if count < 1 or any(not 0 <= size < np.inf for size in spread.values()):
        raise ParameterError(
            f"a population needs at least one device and a scatter of 0 or more; got {count} and {dict(spread)}"
        )
    check_one_device(model)
    space = ParameterSpace.of(model, free=list(spread))
    sizes = np.zeros(len(space))
    for name, size in spread.items():
        leaf, positions = space.named.find(name)
        sizes[[k for k, source in enumerate(space.sources) if source[0] == leaf and source[1] in positions]] = size
    center = space.vector(model)
    lower, upper = np.array([info.bounds for info in space.infos]).T
    noise = sizes * np.random.default_rng(_checked(seed)).standard_normal((count, center.size))
    x = np.where(np.isfinite(lower), center * np.exp(noise), center * (1 + noise))
    if not ((x >= lower) & (x <= upper)).all():
        raise ParameterError(
            f"a scatter of {dict(spread)} leaves the bounds of {type(model).__name__}: make it smaller"
        )
    return space, x


def _checked(seed: int) -> int:
    if seed < 0:
        raise ParameterError(f"the seed of a population must not be negative, got {seed}")
    return seed


def seeds_of(seed: int, count: int) -> list[int]:
    """Independent seeds that follow from one, which is not negative."""
    return [int(word) for word in np.random.SeedSequence(_checked(seed)).generate_state(count)]


def single_models(
    model: Any, count: int, *, spread: Mapping[str, float], seed: int
) -> tuple[list[Any], dict[str, np.ndarray], dict[str, str]]:
    """The devices of `population` one by one, their parameters by name, and the units of these on a piezo (V, um)."""
    space, x = _scattered(model, count, spread, seed)
    label = Scales(u_unit="V", y_unit="um").label
    units = {name: label(info.unit) for name, info in zip(space.names, space.infos, strict=True)}
    devices = [space.coordinates.assemble(jnp.asarray(row)) for row in x]
    return devices, dict(zip(space.names, x.T, strict=True)), units


@dataclasses.dataclass(frozen=True, eq=False)
class Population(Sequence[D], Generic[D]):
    """Devices with known parameters.

    Attributes:
        devices: actuators or stages.
        truth: true parameters by name, shape (n,) each.
        units: of the parameters.
    """

    devices: tuple[D, ...]
    truth: Mapping[str, np.ndarray]
    units: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.devices)

    def __getitem__(self, index: Any) -> Any:
        return self.devices[index]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records: device=1, device=2, ..., as a file with a column of devices is read."""
        return tuple(f"device={k + 1}" for k in range(len(self)))

    def records(self, t: Any, u: Any, *, seed: int, **options: Any) -> Dataset:
        """One record for each device, for `fit`, `fit_many` or a data set to train on.

        Args:
            t: times [s], shape (T,).
            u: commands [V], the same for all devices, shape (T,) for actuators, (T, 3) for stages.
            seed: of the sensor noise.
            **options: of `record` of a device: `every` of actuators, `axis` of stages.
        """
        pairs: Iterator[Any] = zip(self.devices, self.names, seeds_of(seed, len(self)), strict=True)
        return Dataset(
            tuple(device.record(t, u, seed=own, name=name, **options) for device, name, own in pairs), "population"
        )
