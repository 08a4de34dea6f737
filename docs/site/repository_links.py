"""Converts links that lead out of docs/ on a forge to links to pages of the site."""

import os
import re
from pathlib import Path

import example_runs

_LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
_FENCED = re.compile(r"(^```.*?^```|^ {4}.*?$)", re.MULTILINE | re.DOTALL)
# Pages whose text is another file of the repository.
_TEXTS = {
    "changelog": "CHANGELOG.md",
    "contributing": "CONTRIBUTING.md",
    "other-programs": "benchmarks/README.md",
    "ros2-nodes": "ros2_nodes/README.md",
    "security": "SECURITY.md",
}
_PAGES = {
    "README.md": "index.md",
    "LICENSE": "index.md",
    "CITATION.cff": "contributing.md",
    **{text: f"{page}.md" for page, text in _TEXTS.items()},
    "examples": "examples.md",
    "docs": "index.md",
    "docs/README.md": "index.md",
    "docs/decisions": "decisions/index.md",
    "docs/schemas": "reference/files.md",
}


def for_the_site(docs: Path, page: str, text: str) -> str:
    """The Markdown of a page, its links leading to pages of the site."""
    root = docs.parent
    at = Path("docs", f"{page}.md")
    if page in _TEXTS:
        at = Path(_TEXTS[page])
        text = (root / at).read_text(encoding="utf-8")
    if page == "examples":
        text += example_runs.examples_markdown(docs)
    here = Path(page).parent

    def convert(link: re.Match[str]) -> str:
        target, anchor = link[1], link[2] or ""
        if ":" in target:
            return link[0]
        path = os.path.normpath(at.parent / target)
        if path.startswith("examples/"):
            inside, anchor = "examples.md", f"#{Path(path).stem}py"
        elif path.endswith(".schema.json"):
            inside = f"generated/formats/{Path(path).name.removesuffix('.schema.json')}.md"
        elif path in _PAGES:
            inside = _PAGES[path]
        elif path.startswith("docs/"):
            inside = path.removeprefix("docs/")
        else:
            return link[0]  # Sphinx reports it as a broken link
        return os.path.relpath(inside, here) + anchor

    return "".join(
        part if number % 2 else _LINK.sub(convert, part) for number, part in enumerate(_FENCED.split(text))
    )
