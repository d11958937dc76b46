"""Fitted magnetic materials as files that field and circuit programs read: Jiles-Atherton parameters in their conventions, and branches.

Every text states its units and its convention. A program that lacks a term of the model gets no file, and the reason is listed.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystfit.control.magnetic_material import Law, Material
from hystfit.errors import ModelError
from hystfit.params.units import MU0

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

_LINE = 0.8  # of the largest field, from which the straight line is taken whose intercept is the Bs of LTspice
_CONVENTION = (
    "dM/dHe = max(s (Man - M), 0) / k + c dMan/dHe, He = H + alpha M, Man = Ms (coth(He/a) - a/He), s = sign(dH)"
)


def _needs_law(material: Material) -> Law:
    if material.law is None:
        raise ModelError(f"{material.lacking}: refit with --model jiles-atherton")
    if material.lacking:
        raise ModelError(f"it has no term for {material.lacking}: refit without it")
    return material.law


def _comsol(material: Material) -> str:
    """COMSOL: parameters as a text file of name, expression, description."""
    law = _needs_law(material)
    rows = [
        ("Ms", f"{law.Ms:.9g}[A/m]", "saturation magnetization"),
        ("a_JA", f"{law.a:.9g}[A/m]", "domain wall density"),
        ("kp_JA", f"{law.k:.9g}[A/m]", "pinning loss"),
        ("cr_JA", f"{law.c:.9g}", "magnetization reversibility"),
        ("alpha_JA", f"{law.alpha:.9g}", "inter-domain coupling, H and M in A/m"),
    ]
    return "\n".join([f'{name} {value} "{text}"' for name, value, text in rows]) + "\n"


def _flux(material: Material) -> str:
    """Altair Flux and others: the same numbers as a table with units and the convention."""
    law = _needs_law(material)
    units = {"Ms": "A/m", "a": "A/m", "k": "A/m", "alpha": "1", "c": "1"}
    rows = [f"{name},{getattr(law, name):.9g},{unit}" for name, unit in units.items()]
    head = [f"# {_CONVENTION}", "# B = mu0 (H + M); matrices of anisotropic programs are diagonal", "name,value,unit"]
    return "\n".join([*head, *rows, ""])


def _spice(material: Material) -> str:
    """SPICE, CORE model: A/m; without alpha, c in the convention of 1984."""
    law = _needs_law(material)
    if law.alpha != 0.0:
        raise ModelError("the CORE model has no alpha: refit with --fix coupling=0")
    if law.c >= 1.0:
        raise ModelError("c = 1 has no irreversible part")
    c84, k84 = law.c / (1 - law.c), law.k * (1 - law.c)
    head = [
        "* Jiles-Atherton 1984: dM/dH = (Man - M) / (s K (1 + C)) + C / (1 + C) dMan/dH, without alpha; fields in A/m",
        "* set AREA [cm^2], PATH and GAP [cm] of the core",
    ]
    line = f".MODEL material CORE (MS={law.Ms:.9g} A={law.a:.9g} K={k84:.9g} C={c84:.9g} AREA=1 PATH=1 GAP=0)"
    return "\n".join([*head, line, ""])


def _winding(material: Material) -> str:
    """ngspice and LTspice: a winding as a subcircuit, with every term of the law."""
    if material.law is None:
        raise ModelError(material.lacking)
    if material.law.air < 0 or material.law.mu <= 0:
        raise ModelError("the straight line falls, which makes any winding unstable: refit without linear")
    return winding(material.law)


def _ltspice(material: Material) -> str:
    """LTspice: Chan's model by Hc, Br and Bs of the steady loop."""
    h, (rising, falling) = material.h[0], material.b
    if not (rising[0] < 0 < rising[-1] and h[0] < 0 < h[-1]):
        raise ModelError("the loop does not pass through zero")
    coercive = 0.5 * (float(np.interp(0.0, rising, h)) - float(np.interp(0.0, falling, h)))
    remanent = 0.5 * (float(np.interp(0.0, h, falling)) - float(np.interp(0.0, h, rising)))
    far = h >= _LINE * h[-1]
    _, intercept = np.polyfit(h[far], 0.5 * (rising[far] + falling[far]), 1)
    if not 0 < remanent < intercept:
        raise ModelError("the intercept of the line at high fields is not above the remanence")
    head = [
        "* Chan's model: Hc [A/m], Br [T], Bs [T], the intercept of the line at high fields; area, length and gap in m^2 and m"
    ]
    line = f"Lcore 1 0 Hc={coercive:.9g} Br={remanent:.9g} Bs={intercept:.9g} A={{area}} Lm={{length}} Lg={{gap}} N={{turns}}"
    return "\n".join([*head, ".param area=1e-4 length=0.1 gap=0 turns=1", line, ""])


def _ansys(material: Material) -> str:
    """Ansys Maxwell: the falling branch of the major loop as a tab-separated table."""
    h, b = material.h[1], material.b[1]
    rows = [f"{x:.9g}\t{y:.9g}" for x, y in zip(h, b, strict=True)]
    return "\n".join(['"H (A_per_meter)"\t"B (tesla)"', *rows, ""])


def _jmag(material: Material) -> str:
    """JMAG: both branches as columns."""
    rows = [f"{h:.9g},{up:.9g},{down:.9g}" for h, up, down in zip(material.h[0], *material.b, strict=True)]
    return "\n".join(["H (A/m),B rising (T),B falling (T)", *rows, ""])


def _modelica(material: Material) -> str:
    """Modelica, FluxTubes: tables of the rising and the falling branch, which must not cross."""
    h, (rising, falling) = material.h[0], material.b
    if (
        (np.diff(rising) <= 0).any()
        or (np.diff(falling) <= 0).any()
        or (rising > falling + 1e-9 * np.ptp(falling)).any()
    ):
        raise ModelError("the branches cross or do not rise")
    table = lambda b: "{" + ", ".join(f"{{{x:.9g}, {y:.9g}}}" for x, y in zip(h, b, strict=True)) + "}"
    lines = [
        "// Modelica.Magnetic.FluxTubes.Material.HysteresisTableMaterial: H [A/m], B [T]",
        "record Material",
        "  extends Modelica.Magnetic.FluxTubes.Material.HysteresisTableMaterial.General(",
        f"    tabris={table(rising)},",
        f"    tabfal={table(falling)});",
        "end Material;",
    ]
    return "\n".join([*lines, ""])


PROGRAMS: dict[str, tuple[str, Callable[[Material], str]]] = {
    "COMSOL": ("comsol_parameters.txt", _comsol),
    "Flux": ("jiles_atherton.csv", _flux),
    "SPICE": ("spice_core.lib", _spice),
    "SPICE subcircuit": ("winding.lib", _winding),
    "LTspice": ("ltspice_chan.net", _ltspice),
    "Ansys": ("ansys_bh.tab", _ansys),
    "JMAG": ("jmag_bh.csv", _jmag),
    "Modelica": ("modelica.mo", _modelica),
}


def export_field_programs(result: FitResult, folder: str | Path, *, name: str = "material") -> dict[str, Path | str]:
    """Write a magnetic fit for every program that can take it.

    Args:
        result: a fit of B, J or M over H.
        folder: made where it does not exist.
        name: before the names of the files, a word.

    Returns:
        For each program its file, or the reason why there is none.

    Raises:
        ModelError: units that are not those of a field and what it magnetizes, a bad name, or no program that can take the fit.
    """
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise ModelError(f"name must be a word of letters, digits and underscores, got {name!r}")
    material, place = Material.of(result), Path(folder)
    found: dict[str, Path | str] = {}
    for program, (file, text) in PROGRAMS.items():
        try:
            content = text(material)
        except ModelError as error:
            found[program] = str(error)
            continue
        place.mkdir(parents=True, exist_ok=True)
        found[program] = place / f"{name}_{file}"
        (place / f"{name}_{file}").write_text(content, encoding="utf-8")
    return found


_ROUNDED = 1e-6  # added to the square of the argument of the Langevin function, whose terms have no value at zero


def winding(law: Law) -> str:
    """Subcircuit for ngspice and LTspice.

    The voltage gives dB/dt, and two capacitors hold He/a and Mirr/Ms, whose rates follow from dB/dt without a search (Sadowski and others
    2002); the field gives the current. Only functions that both programs have are used, and no powers, which they write differently.
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
