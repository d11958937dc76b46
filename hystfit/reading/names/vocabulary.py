"""The words that names of columns are made of, from `column_names.toml`."""

from __future__ import annotations

import tomllib
from importlib.resources import files

VOCABULARY = tomllib.loads((files("hystfit.reading.names") / "column_names.toml").read_text(encoding="utf-8"))
WORDS, ROLES = (
    {word: kind for kind, words in VOCABULARY[table].items() for word in words.split()} for table in ("words", "roles")
)
