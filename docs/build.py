"""Build the documentation site.

    python docs/build.py [--quick] [--download] [--out build/docs]

Assembles the pages of docs/ and those generated from the package in OUT/source, and has Sphinx make OUT/site from them. The full form
executes the notebooks (in their short form, where there is no newer run of them) and the scripts of the gallery. `--quick` shows both
without outputs, and one picture for all models. Scripts of measured loops whose data are neither in the folder named by
HYSTFIT_DATA nor in the user's cache are left out of the full form, unless `--download` fetches the data.
"""

from __future__ import annotations

import argparse
import functools
import gc
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))
OPEN_IN = (
    "Open in {{download}}`Jupyter <files/{name}.ipynb>`, or as {{download}}`Python file <files/{name}.py>` with cells in VS Code, "
    "Spyder or PyCharm."
)


def main(arguments: list[str] | None = None) -> int:
    """Build the site as the command line says; returns the exit status of Sphinx."""
    parser = argparse.ArgumentParser(description="Build the documentation site.")
    parser.add_argument("--quick", action="store_true", help="notebooks and gallery without outputs")
    parser.add_argument("--download", action="store_true", help="download the measured data sets of the gallery")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs", help="folder for the sources and the site")
    chosen = parser.parse_args(arguments)
    source, site = chosen.out / "source", chosen.out / "site"
    shutil.rmtree(source, ignore_errors=True)
    shutil.rmtree(site, ignore_errors=True)
    skip = shutil.ignore_patterns("__pycache__", "*.py", "gallery", "generate", "models.toml", "codes.toml")
    shutil.copytree(HERE, source, ignore=skip)
    shutil.copy2(HERE / "conf.py", source)
    copy_gallery(source / "gallery_scripts", chosen.quick, chosen.download)
    generate(source, chosen.quick)
    copy_results(source)
    copy_notebooks(source, chosen.quick)
    quick = ["-D", "plot_gallery=0"] if chosen.quick else []
    from sphinx.cmd.build import build_main
    from sphinx.search.en import SearchEnglish

    # It is asked for the words of each page anew: 5 % of the time.
    SearchEnglish.stem = functools.cache(SearchEnglish.stem)
    if chosen.quick:
        gc.disable()  # the nodes of all pages stay to the end: looking for others took a tenth of the time
    status = build_main(["-W", "--keep-going", "-q", *quick, str(source), str(site)])  # hystfit is imported once
    print(f"site: {site / 'index.html'}" if status == 0 else "the site has errors", flush=True)
    return status


def generate(source: Path, quick: bool) -> None:
    """Write the pages and parts of pages that follow from the package.

    Args:
        source: folder that Sphinx reads.
        quick: one picture for all models.
    """
    import hystfit as hf

    hf.enable_x64()
    from generate import api, commands, excerpts, explorer_demo, lists, scaling
    from generate.markdown import write
    from generate.model_pages import draw_pictures, write_model_pages

    draw_pictures(source / "models", quick)
    write_model_pages(source / "models")
    for make in (
        lists.statuses,
        lists.quantities,
        lists.codes,
        lists.noises,
        lists.samplers,
        lists.methods,
        lists.signals,
        lists.formats,
        lists.benchmarks,
        excerpts.coverage,
        excerpts.sbc,
        excerpts.contributing,
    ):
        write(source / "parts" / f"{make.__name__}.md", make())
    write(source / "parts" / "scaling.md", scaling.scaling(source / "guide"))
    (source / "extra").mkdir()
    (source / "extra" / "explorer-demo.html").write_text(explorer_demo.explorer_page(), encoding="utf-8")
    write(source / "reference" / "commands.md", commands.command_page())
    write(source / "reference" / "api" / "index.md", api.index_page())
    for page in api.PAGES:
        write(source / "reference" / "api" / f"{page}.md", api.api_page(page))


def copy_results(source: Path) -> None:
    """Copy the numbers and pictures of the experiments, the changelog and the promises, as pages."""
    for page in sorted((ROOT / "experiments").glob("*/RESULTS.md")):
        target = source / "results" / page.parent.name
        target.mkdir(parents=True)
        shutil.copy2(page, target / "index.md")
        for picture in page.parent.glob("*.png"):
            shutil.copy2(picture, target)
    shutil.copy2(ROOT / "CHANGELOG.md", source / "changelog.md")
    shutil.copy2(ROOT / "SECURITY.md", source / "promises.md")


def copy_gallery(target: Path, quick: bool, download: bool) -> None:
    """Copy the scripts of the gallery, without those that would be run on measured data that are not there.

    Args:
        target: folder of the copies.
        quick: the scripts are shown and not run.
        download: fetch measured data.
    """
    import hystfit as hf

    shutil.copytree(HERE / "gallery", target)
    left_out = []
    for script in () if quick else sorted((target / "measured").glob("*.py")):
        try:
            for name in re.findall(r'datasets\.load\("(.+?)"', script.read_text(encoding="utf-8")):
                hf.datasets.load(name, download=download)
        except hf.HystfitError as reason:
            left_out.append(f"{script.name}: {reason}")
            script.unlink()
    if left_out:
        print("left out of the gallery:", *left_out, sep="\n  ", flush=True)
        header = target / "measured" / "GALLERY_HEADER.rst"
        header.write_text(
            f"{header.read_text(encoding='utf-8')}\nThis copy was built without some of the data.\n", encoding="utf-8"
        )


def copy_notebooks(source: Path, quick: bool) -> None:
    """Copy the notebooks, executed unless `quick`; a run that is newer than its notebook is used as it is.

    Args:
        source: folder that Sphinx reads.
        quick: without outputs.
    """
    import jupytext
    import nbformat

    files = source / "notebooks" / "files"  # to download, beside the pages
    files.mkdir(parents=True)
    for path in sorted((ROOT / "notebooks").glob("[0-9]*.py")):
        target, run = files / f"{path.stem}.ipynb", path.parent / "out" / f"{path.stem}.ipynb"
        shutil.copy2(path, files)
        if quick:
            jupytext.write(jupytext.read(path), target)
        else:
            if not run.exists() or run.stat().st_mtime < path.stat().st_mtime:
                command = [sys.executable, str(path.parent / "run.py"), "--quick", path.stem]
                subprocess.run(command, check=True, env={**os.environ, "JAX_PLATFORMS": "cpu"})
            shutil.copy2(run, target)
        page = nbformat.read(target, nbformat.NO_CONVERT)
        page.cells.insert(1, nbformat.v4.new_markdown_cell(OPEN_IN.format(name=path.stem)))
        nbformat.write(page, files.parent / target.name)


if __name__ == "__main__":
    sys.exit(main())
