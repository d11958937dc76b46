"""The models that users choose by name: the one list of them. Their modules are imported when they are used."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from hystfit.registry import attribute

if TYPE_CHECKING:
    from hystfit.models.base import AbstractHysteresis


def _word(value: int | bool | str) -> int | str:
    return ("no", "yes")[value] if isinstance(value, bool) else value


@dataclasses.dataclass(frozen=True)
class Entry:
    """A model that users choose by name."""

    maker: str  # "module:Class" or "module:Class.constructor" within `hystfit.models`, imported when it is used
    place: str  # "core" (a hysteresis), "before" or "after" (filters in series), "beside" (added to the output)
    doc: str  # what it is for, one line
    # whether a model of this class is this variant; the last entry that fits gives its name
    variant: Callable[[Any], bool] = lambda model: True
    # the expressions with it that a comparison tries by default on every record that can drive them
    tried: tuple[str, ...] = ()
    preset: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # settings of this name

    @property
    def make(self) -> Callable[..., AbstractHysteresis]:
        """Builds the model with its defaults, or with settings by name."""
        return functools.partial(attribute(f"hystfit.models.{self.maker}"), **self.preset)

    def makes(self, kind: type) -> bool:
        """Whether it makes models of this class; no model is imported or made for the answer."""
        module, _, constructor = self.maker.partition(":")
        return (kind.__module__, kind.__name__) == (f"hystfit.models.{module}", constructor.partition(".")[0])

    @functools.cached_property
    def default(self) -> AbstractHysteresis:
        """The model with its defaults, made once: models are immutable."""
        return self.make()

    def settings(self) -> dict[str, int | bool | str]:
        """Settings besides the values of parameters, with their defaults."""
        given = inspect.signature(self.make).parameters.values()
        return {p.name: p.default for p in given if isinstance(p.default, (int, str))}

    def shown(self) -> str:
        """The settings as `make_model` takes them."""
        return ":".join(f"{name}={_word(value)}" for name, value in self.settings().items())

    def changed(self, model: AbstractHysteresis) -> list[str]:
        """Settings of a model that differ from the defaults, as `make_model` takes them."""
        chosen = model.settings()
        return [f"{name}={_word(chosen[name])}" for name, value in self.settings().items() if chosen[name] != value]


MODELS: dict[str, Entry] = {
    "duhem": Entry(
        "duhem:Duhem.of_order", "core", "polynomial Duhem (Coleman-Hodgdon); local memory, 9 parameters", tried=("duhem",),
    ),
    "bouc-wen": Entry(
        "bouc_wen:BoucWen", "core", "normalized Bouc-Wen y = c v - h; symmetric loops, 5 parameters", tried=("bouc-wen",),
    ),
    "bouc-wen-asymmetric": Entry(
        "bouc_wen_asymmetric:AsymmetricBoucWen", "core", "generalized Bouc-Wen: exponent, skew, bent backbone; 9 parameters",
        tried=("bouc-wen-asymmetric",),
    ),
    "bouc-wen-force": Entry(
        "bouc_wen_force:BoucWenForce", "core",
        "Bouc-Wen of a yielding element, force against displacement (dampers, steel); 6 parameters", tried=("bouc-wen-force",),
    ),
    "bouc-wen-baber-noori": Entry(
        "bouc_wen_degrading:BoucWenBaberNoori", "core",
        "Bouc-Wen that loses strength and stiffness and pinches (walls, joints); 12 parameters", tried=("bouc-wen-baber-noori",),
    ),
    "self-similar-stops": Entry(
        "self_similar:SelfSimilarStops.of", "core",
        "weighted stops that scale with the largest input so far: degrading and pinched loops; convex solve",
        tried=("self-similar-stops",),
    ),
    "damper": Entry(
        "damper:Damper", "core", "damper: spring, valves, friction, yield force, forces that lag the velocity; convex solve; needs time",
        tried=("damper", "negate+damper"),
    ),
    "dahl": Entry(
        "dahl:Dahl.of", "core", "friction of bristles (Dahl) and a spring; smooth knees without return-point memory; convex solve",
        tried=("dahl", "dahl+viscous"),
    ),
    "lugre": Entry(
        "lugre:LuGre", "core",
        "LuGre friction: presliding, static and Coulomb friction, Stribeck velocity, viscous; needs time and several rates",
        tried=("lugre",),
    ),
    "maxwell-slip": Entry(
        "maxwell_slip:MaxwellSlip.of", "core",
        "generalized Maxwell slip: stops whose limits fall with the velocity; convex solve; needs time and several rates",
        tried=("maxwell-slip",),
    ),
    "steel-02": Entry(
        "steel02:Steel02", "core", "Steel02 (Menegotto-Pinto-Filippou) of steel, stress against strain, as in OpenSees; 8 parameters",
        tried=("steel-02",),
    ),
    # Not tried by default: on the first 60 % of steel_resspylab/example_1 held-out cycles prefer it to hardening plays (2.2 against
    # 2.3 %), and it predicts the rest worse (4.1 against 3.5 %); its first fit takes 4 to 11 s.
    "voce-chaboche": Entry(
        "voce_chaboche:VoceChaboche.of", "core",
        "updated Voce-Chaboche of steel, stress against strain: yield plateau, isotropic hardening, backstresses",
    ),
    # With pinning that falls the loops of three soft materials are two to five times closer, at one parameter more.
    "jiles-atherton": Entry(
        "jiles_atherton:JilesAtherton.of", "core",
        "Jiles-Atherton M(H) or B(H) of magnetic materials; 6 parameters, and alpha; variants of its curve and pinning",
        tried=("jiles-atherton:pinning=yes",),
    ),
    "jiles-atherton-dynamic": Entry(
        "jiles_atherton_dynamic:JilesAthertonDynamic.of", "core",
        "Jiles-Atherton with eddy currents and excess loss, driven by the field; needs time at two rates or more; 8 parameters",
        tried=("jiles-atherton-dynamic",),
    ),
    "jiles-atherton-b": Entry(
        "jiles_atherton_field:JilesAthertonField.of", "core",
        "Jiles-Atherton driven by the flux density: H over B, for solvers and, with viscous and excess, for losses; 6 parameters",
    ),
    "oscillator": Entry(
        "oscillator:BoucWenOscillator", "core",
        "mass, damper and Bouc-Wen spring that softens or hardens; force in, displacement out; needs time", tried=("oscillator",),
    ),
    "preisach": Entry(
        "preisach.model:Preisach.of", "core", "Preisach with cells; weights >= 0 and smooth by a convex solve",
        preset={"n": 30, "spacing": "quantile"}, tried=("preisach",),
    ),
    "preisach-magnetic": Entry(
        "preisach.model:Preisach.of", "core", "Preisach, symmetric about zero input (magnetic materials): mirror cells share a weight",
        lambda model: model.symmetric, preset={"n": 40, "symmetric": True, "spacing": "square"}, tried=("preisach-magnetic",),
    ),
    "preisach-relays": Entry(
        "preisach.model:Preisach.of", "core", "Preisach with the classical point relays", lambda model: model.elements == "relays",
        preset={"n": 20, "elements": "relays", "spacing": "quantile"},
    ),
    "preisach-forc": Entry(
        "preisach.model:Preisach.of", "core",
        "Preisach with cells from first-order reversal curves, each a record that starts from saturation",
        lambda model: model.spacing == "reversal-curves", preset={"n": 40, "spacing": "reversal-curves"}, tried=("preisach-forc",),
    ),
    "preisach-signed": Entry(
        "preisach.signed:SignedPreisach.of", "core", "Preisach with weights of either sign: loops that lead, cross or fall; no inverse",
        preset={"n": 30, "spacing": "quantile"}, tried=("preisach-signed",),
    ),
    "preisach-forc-signed": Entry(
        "preisach.signed:SignedPreisach.of", "core", "like preisach-forc, with weights of either sign: closer to the curves, no inverse",
        lambda model: model.spacing == "reversal-curves", preset={"n": 40, "spacing": "reversal-curves"}, tried=("preisach-forc-signed",),
    ),
    "everett-table": Entry(
        "preisach.tabulated:TabulatedPreisach.of", "core",
        "Preisach table read off curves that rise to peaks and fall back, without a solve (Song et al. 2005)",
    ),
    "prandtl-ishlinskii": Entry(
        "prandtl_ishlinskii:PrandtlIshlinskii.of", "core", "weighted plays; output lags (piezo, magnetics); convex solve",
    ),
    "prandtl-ishlinskii-stop": Entry(
        "prandtl_ishlinskii:PrandtlIshlinskii.of", "core", "weighted stops; force against displacement (dampers, steel); convex solve",
        lambda model: model.operator == "stop", preset={"operator": "stop"},
    ),
    "prandtl-ishlinskii-generalized": Entry(
        "prandtl_ishlinskii:PrandtlIshlinskii.of", "core", "weighted plays with envelopes: asymmetric loops; convex solve",
        lambda model: model.operator == "play" and len(model.envelopes) > 1, preset={"degree": 5, "envelopes": 3},
    ),
    "prandtl-ishlinskii-hardening": Entry(
        "prandtl_ishlinskii:PrandtlIshlinskii.of", "core", "weighted stops that fade with the path: cyclic hardening",
        lambda model: model.hardening.size > 0, preset={"degree": 3, "operator": "stop", "hardening": 3},
    ),
    "rate-dependent-plays": Entry(
        "rate_plays:RateDependentPlays.of", "core",
        "weighted plays whose thresholds grow with the rate; exact inverse; convex solve; needs time and several rates",
        tried=("rate-dependent-plays",),
    ),
    "curve": Entry(
        "curve:Curve.of", "core", "single-valued curve, no hysteresis: alone, or behind a lag or a delay; convex solve",
    ),
    "relay": Entry(
        "relay:Relay", "core", "a switch: two output levels, two thresholds (thermostat, Schmitt trigger, reed switch); no inverse",
        tried=("relay", "relay+linear"),
    ),
    "negate": Entry(
        "negate:Negate", "before", "the input with the opposite sign: outputs that fall as the input rises",
    ),
    "delay": Entry(
        "dynamics:Delay", "before", "pure delay of the input, in samples",
    ),
    "lag": Entry(
        "dynamics:Lag", "before", "one or two first-order lags of the input (amplifier, sensor); needs time",
    ),
    "rate-shift": Entry(
        "rate_shift:RateShift", "before",
        "a field that lags by the logarithm of the rate: coercivity that grows with frequency; needs time",
        tried=("rate-shift+preisach",),
    ),
    "creep": Entry(
        "creep:LinearCreep", "beside", "logarithmic creep of the input, added to the output; needs time",
    ),
    "log-creep": Entry(
        "creep:LogCreep", "after", "logarithmic creep of the displacement, L(t) = L0 (1 + gamma log10 t); needs time",
        tried=("bouc-wen+log-creep",),
    ),
    "viscous": Entry(
        "rate:Viscous", "beside", "force proportional to the rate of the input; needs time", tried=("bouc-wen-force+viscous",),
    ),
    "viscoelastic": Entry(
        "viscoelastic:Viscoelastic.of", "beside",
        "Maxwell elements with log-spaced relaxation times (elastomers, bearings); convex solve; needs time",
        tried=("linear+viscoelastic", "prandtl-ishlinskii-stop+viscoelastic"),
    ),
    "springpot": Entry(
        "springpot:Springpot.of", "beside", "force of fractional order: a power law of time (elastomers); 2 parameters; needs time",
        tried=("linear+springpot",),
    ),
    "excess": Entry(
        "rate:Excess", "beside", "proportional to the root of the input's rate: excess loss over B (Bertotti); needs time",
    ),
    "saturating-rate": Entry(
        "rate:SaturatingRate", "beside", "force that saturates in the input's rate; needs time",
    ),
    "offset": Entry(
        "offset:Offset", "beside", "a constant for each record",
    ),
    "linear": Entry(
        "linear:Linear", "beside", "a straight line of either sign: sample holder, paramagnet, gas spring, leakage",
    ),
    "relaxation": Entry(
        "relaxation:Relaxation", "after", "a part of the output follows slowly (curved actuators); needs time",
        tried=("bouc-wen+relaxation", "bouc-wen-force+relaxation", "prandtl-ishlinskii+relaxation"),
    ),
    "second-order": Entry(
        "dynamics:SecondOrder", "after", "a resonance; needs time", tried=("bouc-wen+second-order", "prandtl-ishlinskii+second-order"),
    ),
}  # fmt: skip
