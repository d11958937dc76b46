"""The command-line reference, from the command line itself."""

from __future__ import annotations

import re

from hystfit.cli import app
from hystfit.cli.verbs import EXAMPLES, VERBS


def command_page() -> str:
    """A section for each verb, with all its options; cyclopts writes them, in the order of `hystfit --help` here."""
    text = app.generate_docs(output_format="markdown")
    intro, *verbs = re.split(r"^## hystfit (?=[a-z-]+$)", text, flags=re.MULTILINE)
    sections = {part.partition("\n")[0].strip(): part.partition("\n")[2].strip() for part in verbs}
    about = intro.partition("```\n\n")[2].partition("## Table of Contents")[0].strip()
    body = (f"(verb-{verb})=\n## {verb}\n\n{_section(sections[verb])}\n\n{_examples(verb)}" for verb in VERBS)
    return "\n\n".join(["# Command line", *(_lines(about)), _HOW, *body])


_HOW = """Every verb takes `--json`, which prints `result.json`, and those that write files take `--out`. `result.json` has a `schema`
(`hystfit.VERB/1`); unknown values are null. An option with several values is repeated: `--fix c=0.15 --fix rho`."""


def _examples(verb: str) -> str:
    """The commands at the end of the help of a verb."""
    return "\n".join(["```console", *(f"$ {line}" for line in EXAMPLES[verb]), "```"])


def _lines(about: str) -> list[str]:
    """Paragraphs of the introduction, each line of its own."""
    return [re.sub(r"\n(?!\n)", "  \n", paragraph) for paragraph in about.split("\n\n")]


def _section(text: str) -> str:
    """Options without the bold headings' colons; names in angle brackets are no HTML."""
    text = re.sub(r"^\*\*(.+?)\*\*:$", r"### \1", text, flags=re.MULTILINE)
    return text.replace("<", "&lt;")
