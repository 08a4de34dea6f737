"""Settings of the site: `make docs` builds it from the Markdown in docs/ into build/site/."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import command_pages
import example_runs
import format_pages
import navigation
import python_pages
import repository_links
from sphinx.application import Sphinx

from eldir.core.version import __version__

project = "eldir"
version = release = __version__
copyright = "the eldir authors, MIT licence"
language = "en"
root_doc = "index"
exclude_patterns = ["README.md", "site", "schemas", "pictures"]
templates_path = []

# The pages are Markdown as a forge shows it, so headings are the only targets.
myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 4
highlight_language = "text"  # most blocks are typed into a shell
smartquotes = False  # `--option` must stay as it is typed
suppress_warnings = ["myst.xref_ambiguous"]

# Docstrings say `name` for code, as in Markdown.
default_role = "code"
autodoc_default_options = {"members": True, "member-order": "bysource"}
_ALIASES = "FloatArray IntArray BoolArray Contact Sensing Weights LargeStep Integrator Precision"
autodoc_type_aliases = {name: name for name in _ALIASES.split()}
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
nitpicky = True
# Names of other libraries, of which nothing is fetched, and of our modules that are not public.
nitpick_ignore_regex = [("py:.*", r".*")]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]

html_theme = "furo"
html_title = "eldir"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_search_scorer = str(Path(__file__).with_name("static") / "scorer.js")
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
pygments_style, pygments_dark_style = "friendly", "github-dark"
copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True


def setup(app: Sphinx) -> None:
    """Write the generated pages; complete each hand-written page when it is read."""
    docs = Path(app.srcdir)
    for write in (command_pages.write, format_pages.write, python_pages.write, example_runs.run):
        write(docs)

    def complete(_: Sphinx, page: str, source: list[str]) -> None:
        text = repository_links.for_the_site(docs, page, source[0])
        source[0] = text + navigation.below(page)

    app.connect("source-read", complete)
    app.connect("html-page-context", _collapse_navigation, priority=400)  # before the theme's


def _collapse_navigation(
    _: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """The left side lists the section of the page and not what lies in the others: all of it in each of
    three hundred pages was half of the time of a build."""
    if whole := context.get("toctree"):
        context["toctree"] = lambda **options: whole(**options | {"collapse": True})
