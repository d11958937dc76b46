"""The explorer as a page without a server: a bundled loop, and Bouc-Wen simulated by a script in the page."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit.explorer.server import document
from hystfit.explorer.session import Session, Source

RECORD, MODEL = "stage-sweep", "bouc-wen"


def explorer_page() -> str:
    """HTML of the page, with the record and the script in it."""
    record = hf.datasets.load(RECORD)
    scene = Session(record, MODEL, source=Source(RECORD, f"record = hf.datasets.load({RECORD!r})")).scene()
    arrays = {"t": record.t, "u64": record.u, "y64": record.y}
    scene["record"] |= {name: base64.b64encode(np.asarray(values, "<f8")).decode() for name, values in arrays.items()}
    scene |= {"live": False, "choices": [MODEL]}
    script = Path(__file__).with_name("bouc_wen.js").read_text(encoding="utf-8")
    return document(scene, model_script=script)
