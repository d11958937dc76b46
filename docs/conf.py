"""Configuration of Sphinx. It runs in the folder that `build.py` has assembled."""

import sys
from pathlib import Path

import hystfit

HERE = Path(__file__).resolve().parent
DOCS = Path(hystfit.__file__).resolve().parents[1] / "docs"
sys.path.insert(0, str(DOCS))  # for `generate`

from generate.docstrings import escape_marks  # noqa: E402

WIDE = ["guide/calibration", "guide/beside"] + [
    path.relative_to(HERE).with_suffix("").as_posix()
    for pattern in ("notebooks/*.ipynb", "results/*/index.md")
    for path in HERE.glob(pattern)
]

project = "hystfit"
author = "the hystfit developers"
copyright = author
version = release = hystfit.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["parts", "gallery_scripts", "gallery/**/*.ipynb", "gallery/**/*.py", "notebooks/files"]
suppress_warnings = ["config.cache", "mystnb.unknown_mime_type", "ref.python"]

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
smartquotes = False  # "--out" stays as it is
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks/run.py has executed them
nb_merge_streams = True

autodoc_typehints = "none"  # shapes and units are in the text
autodoc_member_order = "bysource"
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False
napoleon_custom_sections = ["Class attributes"]
maximum_signature_line_length = 88

sphinx_gallery_conf = {
    "examples_dirs": "gallery_scripts",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "image_srcset": ["2x"],
    "abort_on_example_error": True,
    "capture_repr": (),  # what a script prints, without the axes that its last line returns
}

html_context = {"default_mode": "auto"}  # light or dark as the reader's system is
html_theme = "pydata_sphinx_theme"
html_title = "hystfit"
html_static_path = ["static"]
html_extra_path = ["extra"]
html_favicon = "static/favicon.svg"
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_sidebars = {"index": [], "start": []}
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "show_prev_next": False,
    # pages with wide tables and long lines use the space of the list of headings
    "secondary_sidebar_items": {
        "**": ["page-toc"],
        **{page: [] for page in WIDE},
    },
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = "$ "


def setup(app):
    """Read docstrings as the plain text that they are."""
    app.connect("autodoc-process-docstring", escape_marks, priority=100)
