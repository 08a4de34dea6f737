"""Writes the table of codes into docs/reference/errors.md, from classes of errors and the places that raise
them: python docs/site/errors.py
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "errors.md"
PACKAGES = ("eldir", "hardware", "calibration", "cad", "app", "ros2_nodes")
HEAD = "| code | what failed | class |\n| --- | --- | --- |\n"
_TABLE = re.compile(re.escape(HEAD) + r"(\|.*\n)*")
_CODE = re.compile(r"[a-z-]+(\.[a-z-]+)?")


def page_text() -> str:
    """The page, with the table as the code has it."""
    rows: dict[str, tuple[set[str], set[str]]] = {}
    for path in sorted(p for name in PACKAGES for p in (ROOT / name).rglob("*.py")):
        for code, sentence, kind in _codes(ast.parse(path.read_text(encoding="utf-8")), None):
            sentences, kinds = rows.setdefault(code, (set(), set()))
            sentences |= {sentence} if sentence.strip(".: ") else set()  # not one that has only values
            kinds.add(f"`{kind}`")
    table = (
        f"| `{code}` | {'; '.join(sorted(s))} | {', '.join(sorted(k))} |\n" for code, (s, k) in rows.items()
    )
    return _TABLE.sub(lambda _: HEAD + "".join(sorted(table)), PAGE.read_text(encoding="utf-8"), count=1)


def _codes(node: ast.AST, inside: ast.FunctionDef | None) -> Iterator[tuple[str, str, str]]:
    """Each code below a node, with what failed and the class of the error."""
    if isinstance(node, ast.FunctionDef):
        inside = node
    if isinstance(node, ast.ClassDef):
        own = ast.Module([n for n in node.body if isinstance(n, ast.Assign | ast.AnnAssign)], [])
        if _CODE.fullmatch(code := _assigned(own, "code")):
            yield code, _first_sentence(node), node.name
    if isinstance(node, ast.Call) and inside is not None:
        for code in (_text(k.value, inside) for k in node.keywords if k.arg == "code"):
            if _CODE.fullmatch(code):
                match = re.match("the error for (.*)", _first_sentence(inside))
                yield code, match[1] if match else _text(node.args[0], inside), ast.unparse(node.func)
    for child in ast.iter_child_nodes(node):
        yield from _codes(child, inside)


def _text(node: ast.AST, inside: ast.AST) -> str:
    """A text in the code, with ... for each value that is put in; of a name, the text that it stands for."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_text(part, inside) for part in parts)
        case ast.IfExp(body=body):
            return _text(body, inside)
        case ast.BinOp(left=left, right=right):
            return _text(left, inside) + _text(right, inside)
        case ast.Name(id=name, lineno=line):
            return _assigned(inside, name, line) or "..."
    return "..."


def _assigned(inside: ast.AST, name: str, line: int = 1 << 30) -> str:
    """The last text before a line that is assigned to a name."""
    found = ""
    for node in ast.walk(inside):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and node.lineno < line:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts, strict=True))
            found = next((_text(v, inside) for t, v in pairs if ast.unparse(t) == name), found)
    return found


def _first_sentence(node: ast.ClassDef | ast.FunctionDef) -> str:
    """The first sentence of its docstring, as a part of a sentence."""
    sentence = " ".join((ast.get_docstring(node) or "").split()).partition(". ")[0].removesuffix(".")
    return sentence[:1].lower() + sentence[1:]


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
