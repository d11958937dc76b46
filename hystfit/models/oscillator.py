"""A mass on a damper and a hysteretic spring: force in, displacement out (Wen 1976), softening or hardening."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen_steps import any_power, zeroth_power
from hystfit.models.oscillator_start import REACH, oscillator_starts, upsample
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.sample_scan import scan_samples
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.step_inverse import COMES_LATER
from hystfit.outcome import Code
from hystfit.params.host_arrays import compiled
from hystfit.params.param import param
from hystfit.quality.needs import Needs

Between = Literal["bandlimited", "linear", "hold"]
_STABLE = 2.8  # largest step times angular frequency at which Runge-Kutta of fourth order does not grow
_UNEVEN = 0.05  # deviation of a time step from their median, as a fraction of it, up to which the sampling is even
# A force with more than 5 % of its power above 80 % of half the sampling rate is not band-limited.
_UPPER, _UPPER_SHARE = 0.8, 0.05


class BoucWenOscillator(AbstractHysteresis):
    """Mass, damper and hysteretic spring under a force u, displacement y - offset:

        m y'' + c y' + k y + z = u,    z' = kz y' - (b1 |y'| sgn z + b2 y') |z|^n

    in scaled form, without redundancy and with shape parameters of order one:  K = k + kz,  a = k / K,  and at the fixed force Z
    r_load = (b1 + b2) Z^n / kz,  r_unl = (b1 - b2) Z^n / kz.  The tangent dz/dy is kz (1 - r_load |z/Z|^n) on loading and
    kz (1 + r_unl |z/Z|^n) on unloading. r_load > 0 softens, with |z| <= Z r_load^(-1/n); r_load < 0 hardens, for n <= 1 without an
    infinite force. It dissipates for r_load + r_unl >= 0; both >= 0 are the admissible softening forms of Erlicher and Point (2004).
    A fit reports k, kz, b1 and b2 too.

    Runge-Kutta, `substeps` a sample: of fourth order, but of about second order where the velocity or z changes sign, as at every
    reversal. `between` is the force between samples: "bandlimited" (sinc, for evenly sampled
    records of a smooth force; the first and last 24 samples do not count in a fit), "linear", or "hold" (the steps of a D/A
    converter). Only "linear" and "hold" are causal. At rest without force until the first sample.

    Raises:
        ModelError: fewer than one substep, or an unknown `between`.
    """

    no_inverse: ClassVar[str] = COMES_LATER
    rate_independent: ClassVar[bool] = False
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"between": get_args(Between)}
    needs: ClassVar[Needs] = Needs(
        time=True, dynamics=True, too_few="mass, damping and stiffness trade off; measure around the resonance"
    )
    # Its steps in physical coordinates need half as many evaluations as Levenberg-Marquardt's.
    estimator: ClassVar[str] = "trf"

    # m and c are far below their natural size in data that are sampled finely.
    m: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u*s^2/y", scale=1e-3, doc="mass")
    c: Scalar = param(0.1, bounds=(0.0, np.inf), unit="u*s/y", scale=1e-3, doc="damping")
    K: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/y", doc="stiffness at small amplitude, k + kz")
    a: Scalar = param(0.5, bounds=(-0.5, 1.2), doc="part of K without hysteresis, k / K")
    r_load: Scalar = param(
        0.3, bounds=(-5.0, 50.0), doc="softening (> 0) or hardening (< 0) on loading, at the force Z"
    )
    r_unl: Scalar = param(0.3, bounds=(-5.0, 50.0), doc="stiffening on unloading, at the force Z")
    n: Scalar = param(1.0, bounds=(0.5, 12.0), fixed=True, doc="exponent of |z|")
    Z: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="force at which r_load and r_unl apply")
    offset: Scalar = param(0.0, unit="y", per_record=True, doc="displacement reading at rest", linear=True)
    between: Between = eqx.field(static=True, default="bandlimited")
    substeps: int = eqx.field(static=True, default=4)

    def __check_init__(self) -> None:
        if self.substeps < 1:
            raise ModelError(f"at least one substep per sample is needed, got {self.substeps}")

    # -- simulation ----------------------------------------------------------------------------------------------------

    @property
    def causal(self) -> bool:
        """Whether the force between samples is independent of later samples."""
        return self.between != "bandlimited"

    def init(self, u0: Scalar) -> State:
        """State: displacement, velocity, z, and 1 once the first sample is read; at rest without force."""
        return jnp.zeros((4,)) + 0.0 * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample.

        Raises:
            ModelError: the force between samples depends on later samples.
        """
        if not self.causal:
            raise ModelError(f"a band-limited force needs the {REACH} samples that follow: {_CAUSAL}")
        state, y = self.sweep(state, u0, u1[None], dt[None])
        return state, y[0]

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """The force at all Runge-Kutta stages first, then one scan over the substeps with the state as three numbers."""
        state, y, _ = self._trajectory(state, u0, u, dt)
        return state, self.offset + y

    def _trajectory(self, state: Array, u0: Array, u: Array, dt: Array) -> tuple[Array, Array, Array]:
        """State after the last sample, displacement and z at each."""
        force = self._force(jnp.concatenate([u0[None], u]))
        # The time before the first sample does not count: the mass rests until then.
        step = dt.at[0].multiply(state[3]) / self.substeps
        substeps = (
            force[:, :-1:2],
            force[:, 1::2],
            force[:, 2::2],
            jnp.broadcast_to(step[:, None], force[:, 2::2].shape),
        )

        def scanned(power: Callable[[Array, Array], Array]) -> tuple[Array, ...]:
            once = lambda carry, sample: (new := self._runge_kutta(power, carry, *sample), (new[0], new[2]))
            flat = tuple(part.reshape(-1) for part in substeps)
            (y, v, z), (ys, zs) = scan_samples(
                once, (state[0], state[1], state[2]), flat, rows_per_sample=self.substeps
            )
            last = lambda values: values[self.substeps - 1 :: self.substeps]
            return jnp.stack([y, v, z, jnp.ones_like(y)]), last(ys), last(zs)

        # Without exponential and logarithm where n = 1: they take most of the time of a step.
        first_power = lambda x, n: x * zeroth_power(x, n)  # the logarithm is in the derivative by n alone
        return jax.lax.cond(self.n == 1.0, lambda: scanned(first_power), lambda: scanned(any_power))

    def hysteretic_share(self, u: np.ndarray, dt: np.ndarray) -> float | None:
        """Work of z over all dissipated work; what the spring stores at the end is small compared with many cycles."""
        y, z = (np.asarray(values) for values in _driven(self, jnp.asarray(u), jnp.asarray(dt)))
        way, steps = np.diff(y), np.maximum(dt[1:], 1e-300)
        spring = float(np.sum(0.5 * (z[1:] + z[:-1]) * way))
        damper = float(self.c) * float(np.sum(way**2 / steps))
        return max(spring, 0.0) / (max(spring, 0.0) + damper) if damper > 0 else None

    def _force(self, u: Array) -> Array:
        """Force at the ends and midpoints of all substeps of each interval between samples, shape (T, 2 substeps + 1)."""
        parts = 2 * self.substeps
        if self.between == "bandlimited":
            return upsample(u, parts)
        if self.between == "hold":
            return jnp.broadcast_to(u[:-1, None], (u.shape[0] - 1, parts + 1))
        return u[:-1, None] + (u[1:] - u[:-1])[:, None] * (jnp.arange(parts + 1) / parts)

    def _runge_kutta(
        self,
        power: Callable[[Array, Array], Array],
        at: tuple[Array, ...],
        f0: Array,
        middle: Array,
        f1: Array,
        h: Array,
    ) -> tuple[Array, ...]:
        """One substep of length h of (y, v, z) under the forces at its ends and its middle."""
        k, kz, per_mass, per_force = self.a * self.K, (1 - self.a) * self.K, 1 / self.m, 1 / self.Z
        share, skew = 0.5 * (self.r_load + self.r_unl), 0.5 * (self.r_load - self.r_unl)

        def slope(y: Array, v: Array, z: Array, force: Array) -> tuple[Array, ...]:
            size = power(jnp.abs(z) * per_force, self.n)
            lost = (share * jnp.abs(v) * jnp.sign(z) + skew * v) * size
            return v, (force - self.c * v - k * y - z) * per_mass, kz * (v - lost)

        moved = lambda rates, part: tuple(q + part * h * rate for q, rate in zip(at, rates, strict=True))
        k1 = slope(*at, f0)
        k2 = slope(*moved(k1, 0.5), middle)
        k3 = slope(*moved(k2, 0.5), middle)
        k4 = slope(*moved(k3, 1.0), f1)
        rates = tuple((p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(k1, k2, k3, k4, strict=True))
        return moved(rates, 1.0)

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """See the base class.

        Raises:
            ModelError: uneven sampling under a band-limited force.
        """
        if dt is not None:
            self._check_even(np.broadcast_to(np.asarray(dt, dtype=float), np.shape(u))[1:])
        return super().free_run(u, dt)

    def _check_even(self, steps: np.ndarray) -> None:
        typical = float(np.median(steps)) if steps.size else 0.0
        if not self.causal and np.max(np.abs(steps - typical), initial=0.0) > _UNEVEN * typical:
            raise ModelError(
                f"a band-limited force needs even sampling, and the time steps are {steps.min():.3g} to {steps.max():.3g}: "
                f"resample the record, or {_CAUSAL}"
            )

    # -- fitting -------------------------------------------------------------------------------------------------------

    def prepared(self, record: Record) -> Record:
        """The first and last samples, between which a band-limited force is not known, do not count.

        Raises:
            ModelError: uneven sampling under a band-limited force.
        """
        record = super().prepared(record)
        if self.causal or record.t is None:
            return record
        self._check_even(np.diff(record.t))
        weight = np.array(record.weight)
        weight[:REACH] = weight[-REACH:] = 0.0
        if np.array_equal(weight, record.weight):
            return record
        text = f"the first and last {REACH} samples have weight 0: the band-limited force there depends on samples outside the record"
        return record.replace(weight=weight).noted(Code.PREPARED, text)

    def start(self, records: Sequence[Record]) -> BoucWenOscillator:
        return self.starting_points(records)[0]

    def starting_points(self, records: Sequence[Record]) -> tuple[BoucWenOscillator, ...]:
        """Mass, damping and stiffness from the transfer function, and the best shapes of two grids with them."""
        return oscillator_starts(self, records)

    def derived(self) -> tuple[Derived, ...]:
        """Stiffnesses and the constants of the law of z in their usual form."""
        n = float(self.n)
        unit = "1/y" if n == 1 else f"u^{1 - n:g}/y"
        kz = lambda s: (1 - s.a) * s.K
        per_power = lambda s: 0.5 * kz(s) * s.Z ** (-s.n)
        return (
            Derived("k", "u/y", "stiffness of the elastic spring", lambda s: s.a * s.K),
            Derived("kz", "u/y", "stiffness of the hysteretic spring at z = 0", kz),
            Derived("b1", unit, "factor of |y'| sgn z |z|^n", lambda s: per_power(s) * (s.r_load + s.r_unl)),
            Derived("b2", unit, "factor of y' |z|^n", lambda s: per_power(s) * (s.r_load - s.r_unl)),
        )

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the simulation is unstable or coarse, the force not band-limited, or the spring not dissipative."""
        load, unload = float(self.r_load), float(self.r_unl)
        lines = []
        if load + unload < 0:
            lines.append(f"the spring is not dissipative: r_load + r_unl = {load + unload:.3g} is negative")
        if load < 0 and float(self.n) > 1:
            lines.append(
                f"a hardening spring with n = {float(self.n):.3g} > 1 has an infinite force at a finite displacement: keep n <= 1"
            )
        if dt is not None:
            lines += self._coarse(u, dt)
        share = _upper_share(u)
        if not self.causal and share > _UPPER_SHARE:
            lines.append(
                f"{100 * share:.2g} % of the force's power lies near half the sampling rate, where band-limited interpolation "
                "is wrong: use between='linear', or between='hold' for a D/A converter (at the shell :between=hold after the model's name)"
            )
        return tuple(lines)

    def _coarse(self, u: np.ndarray, dt: np.ndarray) -> list[str]:
        """Advice on the step of Runge-Kutta along the simulation of u."""
        z = np.asarray(_driven(self, jnp.asarray(u), jnp.asarray(dt))[1])
        if not np.isfinite(z).all():
            return [f"the simulation is not finite: sample faster, or take more than {self.substeps} substeps"]
        power = float(np.max(np.abs(z), initial=0.0) / self.Z) ** float(self.n)
        stretch = 1 + max(0.0, -float(self.r_load) * power, float(self.r_unl) * power)
        kz = (1 - float(self.a)) * float(self.K)
        tangent = max(float(self.K), float(self.a) * float(self.K) + kz * stretch)
        lines = []
        turns = float(np.max(dt)) * np.sqrt(tangent / float(self.m))
        if turns / self.substeps > _STABLE:
            lines.append(
                f"a Runge-Kutta step is {turns / self.substeps:.2g} / (largest angular frequency), and the method is stable up to "
                f"{_STABLE}: take substeps={int(np.ceil(turns / _STABLE))} or more, or sample faster"
            )
        if float(self.r_unl) * power < -1:
            lines.append("the tangent on unloading is negative at the largest force: r_unl is too small for a spring")
        return lines

    # -- control -------------------------------------------------------------------------------------------------------

    def c_part(self) -> CPart:
        """Runge-Kutta under a force that is linear between samples or held.

        Raises:
            ModelError: the force between samples depends on later samples.
        """
        if not self.causal:
            raise ModelError(
                f"a band-limited force needs the {REACH} samples that follow, which C code does not have: {_CAUSAL}"
            )
        return CPart.of(self, "oscillator", hold=self.between == "hold")


_CAUSAL = "use between='linear' or between='hold' (at the shell, oscillator:between=linear)"


def _upper_share(u: np.ndarray) -> float:
    """Part of the power of u, shape (T,), in the highest fifth of its spectrum, of the record less a line and under a Hann window."""
    rest = np.asarray(u) - np.linspace(u[0], u[-1], len(u))
    power = np.abs(np.fft.rfft(rest * np.hanning(len(u)))) ** 2
    return float(power[int(_UPPER * power.size) :].sum() / (power.sum() or 1.0))


@compiled
def _driven(model: BoucWenOscillator, force: Array, dt: Array) -> tuple[Array, Array]:
    """Displacement and z at each sample."""
    _, y, z = model._trajectory(model.init(force[0]), force[0], force, dt)
    return y, z
