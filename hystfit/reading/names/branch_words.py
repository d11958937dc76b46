"""Words that name the two branches of a loop, in columns and in their values."""

from __future__ import annotations

import re

RISING = frozenset(
    "up rising rise ris ascending asc increasing inc loading load heating heat warming warm upward upscale charging charge "
    "adsorption adsorbed adsorp sorption ads drying drainage "
    "forward fwd positive pos extend ext ex approach press trace advancing intrusion inflation inspiration compression "
    "cw clockwise "
    "auf aufwärts steigend aufsteigend zunehmend hin belastung ladung aufheizen erwärmung chauffage chauffe calentamiento "
    "aller montée montee ida subida carga creciente crescente croissant croissante 加载 升程 正行程 升温 上り 上昇 負荷".split()
)
FALLING = frozenset(
    "down falling fall fal descending desc decreasing dec unloading unload cooling cool downward downscale discharging discharge "
    "desorption desorbed desorp des wetting imbibition "
    "backward bwd reverse rev return negative neg retract ret rt withdraw release retrace receding extrusion deflation "
    "expiration rebound ccw acw counterclockwise anticlockwise "
    "ab abwärts fallend absteigend abnehmend rück zurück entlastung entladung abkühlen abkühlung refroidissement enfriamiento "
    "retour descente vuelta bajada descarga decreciente decrescente décroissant décroissante 卸载 回程 反行程 降温 下り 下降 除荷".split()
)
BRANCHES = RISING | FALLING


def words_of(name: str) -> set[str]:
    """Words of a name in lower case: those between underscores and signs, and those of CamelCase; a number at the end is a word."""
    return set(re.findall(r"[^\W\d_]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", str(name)).lower()))
