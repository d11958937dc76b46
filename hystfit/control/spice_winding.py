"""A winding on a core as a subcircuit of behavioral sources: Jiles-Atherton with all its terms, driven by the voltage."""

from __future__ import annotations

from hystfit.control.magnetic_law import Law
from hystfit.params.units import MU0

_ROUNDED = 1e-6  # added to the square of the argument of the Langevin function, whose terms have no value at zero


def winding(law: Law) -> str:
    """Subcircuit for ngspice and LTspice.

    The voltage gives dB/dt, and two capacitors hold He/a and Mirr/Ms, whose rates follow from dB/dt without a search (Sadowski and
    others 2002); the field gives the current. Only functions that both programs have are used, and no powers, which they write
    differently.

    Args:
        law: the material.
    """
    number = lambda value: f"{value:.9g}"
    curves = [("", law.p, 1.0)] if law.p == 1.0 else [("1", law.p, 1.0), ("2", 1.0 - law.p, law.r)]
    core = "q" if law.air else "p"  # the flux of air beside the core is that of an inductor before it
    sources: dict[str, str] = {"rate": f"V({core},n)/({{turns}}*{{area}})"}
    for tag, _, ratio in curves:
        x = "V(x)" if ratio == 1.0 else f"V(x)/{number(ratio)}"
        sources |= _curve(tag, x, tanh=law.tanh)
    mixed = lambda node, power: "+".join(
        (f"{number(weight / ratio**power)}*" if law.p != 1.0 else "") + f"V({node}{tag})"
        for tag, weight, ratio in curves
    )
    pinning = f"{number(law.a / law.k)}*max(sgn(V(rate))*(V(an)-V(m)),0)"
    inner = f"{number(law.a)}*V(x)-{number(law.alpha * law.Ms)}*V(tot)"
    rest = 1 - law.mu * law.alpha
    dynamic = f"+{number(law.eddy)}*V(rate)" if law.eddy else ""
    if law.excess:
        dynamic += f"+{number(law.excess)}*V(rate)/sqrt(sqrt(V(rate)*V(rate)+{number(law.e**2)}))"
    sources |= {
        "an": mixed("man", 0),
        "tot": f"{number(law.c)}*V(an)+{number(1 - law.c)}*V(m)",
        "follow": pinning + (f"*exp({number(law.q)}*V(tot)*V(tot))" if law.q else ""),
        "chi": f"{number(law.c)}*({mixed('bend', 1)})+{number(1 - law.c)}*V(follow)",
        "move": f"V(rate)/({number(MU0 * law.mu * law.a)}+{number(MU0 * law.Ms * rest)}*V(chi))",
        "core": f"{number(MU0)}*({number(law.mu * law.a)}*V(x)+{number(rest * law.Ms)}*V(tot))",
        "h": inner + dynamic + (f"+{number(law.gap)}*V(core)" if law.gap else ""),
        "b": "V(core)" + (f"+{number(law.air)}*V(h)" if law.air else ""),
    }
    head = [
        "* winding on a core: turns, area [m^2], length of the path [m]; inside, node h is the field [A/m] and b the flux density [T]",
        "* dM/dHe = max(s (Man - M), 0) / k + c dMan/dHe, He = H - Hdyn + alpha M; x = He/a, m = Mirr/Ms; demagnetized at first",
        "* rpar carries the current that the field does not take, where a source of current drives the winding",
        ".subckt winding p n params: turns=1 area=1e-4 length=0.1 rpar=1e6",
    ]
    body = [f"B{node} {node} 0 V={expression}" for node, expression in sources.items()]
    states = [
        line
        for node, rate in (("x", "V(move)"), ("m", "V(follow)*V(move)"))
        for line in (f"B{node} 0 {node} I={rate}", f"C{node} {node} 0 1", f"R{node} {node} 0 1e12")
    ]
    ports = [f"Bi {core} n I=V(h)*{{length}}/{{turns}}", f"Rpar {core} n {{rpar}}"]
    ports += [f"Lair p q {{{number(law.air)}*turns*turns*area/length}}"] if law.air else []
    return "\n".join([*head, *body, *states, *ports, ".ic V(x)=0 V(m)=0", ".ends winding", ""])


def _curve(tag: str, x: str, *, tanh: bool) -> dict[str, str]:
    """Sources of an anhysteretic curve f(x) and of its slope f'(x)."""
    man, bend = f"man{tag}", f"bend{tag}"
    if tanh:
        return {man: f"tanh({x})", bend: f"1-V({man})*V({man})"}
    y, g = f"y{tag}", f"g{tag}"  # |x|, and f(x)/x; f' = 1 - f^2 - 2 f/x
    return {
        y: f"sqrt(({x})*({x})+{_ROUNDED:g})",
        g: f"(1/tanh(V({y}))-1/V({y}))/V({y})",
        man: f"{x}*V({g})",
        bend: f"1-V({man})*V({man})-2*V({g})",
    }
