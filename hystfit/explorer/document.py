"""The page of the explorer as one self-contained document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

_PARTS = ("panel.js", "source.js", "explorer.js")


def document(scene: Mapping[str, Any], *, model_script: str = "", nonce: str = "") -> str:
    """HTML with style, scripts and data in it.

    Args:
        scene: what the page shows first, see `Session.scene`.
    """
    from jinja2 import Environment, PackageLoader

    texts = {
        path.name: path.read_text(encoding="utf-8") for path in files("hystfit.explorer").joinpath("page").iterdir()
    }
    environment = Environment(loader=PackageLoader("hystfit.explorer", "page"), autoescape=True)
    return environment.get_template("explorer.html").render(
        style=texts["explorer.css"],
        script="\n".join([model_script, *(texts[part] for part in _PARTS)]),
        scene=json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
        name=scene["record"]["name"],
        nonce=nonce,
    )
