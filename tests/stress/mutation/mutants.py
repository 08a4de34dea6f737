"""The list of mutants of a module: one changed node of its syntax tree each.

Left out: annotations, docstrings, and the texts of messages (arguments of `raise` and of errors, texts of
three words and more, `remedy`, `expected`, `found`).
"""

from __future__ import annotations

import ast
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

BOUNDARY = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
NEGATION = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.BitXor: ast.BitAnd,
}
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil"}
PLAIN = {"sorted": "list", "abs": "float"}
SILENT = {"remedy", "expected", "found"}  # arguments that are shown to people
_WORDS = 3  # a text of so many words is a message
_ROUNDING = 1e-4  # a number below it allows for rounding: the mutant is without it


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    module: str
    """Path from the root of the repository."""
    where: str
    """Function or class, `<module>` outside of both."""
    before: str
    """What stands there, on one line."""
    after: str
    """What stands there instead."""
    number: int
    """Which of the same changes in the same place, from 1."""
    line: int
    source: str
    """The whole changed module."""

    @property
    def key(self) -> tuple[str, str, str, str, int]:
        """Names the mutant, also after lines have moved."""
        return self.module, self.where, self.before, self.after, self.number

    def __str__(self) -> str:
        return f"{self.module}:{self.line} {self.where}: {self.before} -> {self.after}"


@dataclass(frozen=True)
class _Change:
    """A change that can be made and taken back."""

    node: ast.AST
    where: str
    line: int
    before: str
    make: Callable[[], Callable[[], None]]
    """Makes the change and returns what takes it back."""
    after: str = ""


def mutants(module: str, source: str, *, written: bool = True) -> list[Mutant]:
    """All mutants of a module, always in the same order; with an empty `source` if they are not to be
    `written`, which takes ten times as long as finding them."""
    tree = ast.parse(source)
    found, seen = [], Counter[tuple[str, str, str]]()
    # Only the changed one of the module's statements is written anew: writing a module takes 10 ms.
    texts = [ast.unparse(statement) for statement in tree.body]
    first_lines = [min(n.lineno for n in (s, *getattr(s, "decorator_list", ()))) for s in tree.body]
    for change in _Finder().changes(tree):
        k = bisect_right(first_lines, change.line) - 1
        undo = change.make()
        after = change.after or _text(change.node)
        statements = tree.body[k : k + 1 + len(tree.body) - len(texts)] if written else []
        changed = "\n".join([*texts[:k], *map(ast.unparse, statements), *texts[k + 1 :]]) if written else ""
        undo()
        place = change.where, change.before, after
        seen[place] += 1
        found.append(Mutant(module, *place, seen[place], change.line, changed))
    return found


def _text(node: ast.AST) -> str:
    return " ".join(ast.unparse(node).split())


def _replace(node: ast.AST, name: str, value: object) -> Callable[[], Callable[[], None]]:
    def make() -> Callable[[], None]:
        old = getattr(node, name)
        setattr(node, name, value)
        return lambda: setattr(node, name, old)

    return make


def _replace_in(nodes: list, index: int, new: list) -> Callable[[], Callable[[], None]]:
    def make() -> Callable[[], None]:
        old = list(nodes)
        nodes[index : index + 1] = new

        def undo() -> None:
            nodes[:] = old

        return undo

    return make


class _Finder:
    """Walks a tree and yields its changes."""

    def changes(self, tree: ast.Module) -> Iterator[_Change]:
        yield from self._body(tree.body, "<module>", docstring=True)

    # Statements.

    def _body(self, body: list[ast.stmt], where: str, docstring: bool = False) -> Iterator[_Change]:
        for i, statement in enumerate(body):
            if docstring and _is_text(statement):
                continue
            if _removable(statement):
                yield _Change(
                    statement, where, statement.lineno, _text(statement),
                    _replace_in(body, i, [ast.Pass()]), "pass",
                )  # fmt: skip
            yield from self._statement(statement, where, body, i)

    def _statement(  # noqa: PLR0912 - one branch a kind of statement
        self, node: ast.stmt, where: str, body: list[ast.stmt], i: int
    ) -> Iterator[_Change]:
        match node:
            case ast.Import() | ast.ImportFrom() | ast.Pass():
                return
            case ast.FunctionDef() | ast.ClassDef():
                yield from self._definition(node, where)
                return
            case ast.AnnAssign():
                if node.value is not None:
                    yield from self._expression(node, "value", where)
                return
            case ast.Raise():
                return  # its removal is enough: the rest is the message
            case (
                ast.If(test=ast.Name(id="TYPE_CHECKING"))
                | ast.If(test=ast.Compare(left=ast.Name("__name__")))
            ):
                return
            case ast.Return() if node.value is not None and not _nothing(node.value):
                yield _Change(
                    node, where, node.lineno, _text(node), _replace(node, "value", ast.Constant(None))
                )
            case ast.Break():
                yield self._other(node, where, body, i, ast.Continue())
            case ast.Continue():
                yield self._other(node, where, body, i, ast.Break())
            case ast.AugAssign():
                yield from self._operator(node, where)
            case ast.If() | ast.While():
                yield from self._condition(node, where)
            case ast.With() if all(item.optional_vars is None for item in node.items):
                yield self._other(node, where, body, i, *node.body, before=_text(node).split(":")[0] + ":")
        for field, value in ast.iter_fields(node):
            if isinstance(value, ast.expr):
                yield from self._expression(node, field, where)
            elif isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                yield from self._body(value, where)
            elif isinstance(value, list):
                for k, item in enumerate(value):
                    if isinstance(item, ast.expr):
                        yield from self._listed(value, k, where)
                    elif isinstance(item, ast.withitem):
                        yield from self._expression(item, "context_expr", where)
                    elif isinstance(item, ast.ExceptHandler):
                        yield from self._handler(item, where)
                    elif isinstance(item, ast.match_case):
                        yield from self._body(item.body, where)

    @staticmethod
    def _other(
        node: ast.stmt, where: str, body: list[ast.stmt], i: int, *new: ast.stmt, before: str = ""
    ) -> _Change:
        after = _text(new[0]) if not before else "without it"
        return _Change(
            node, where, node.lineno, before or _text(node), _replace_in(body, i, list(new)), after
        )

    def _definition(self, node: ast.FunctionDef | ast.ClassDef, where: str) -> Iterator[_Change]:
        inside = node.name if where == "<module>" else f"{where}.{node.name}"
        if isinstance(node, ast.FunctionDef):
            for values in (node.args.defaults, node.args.kw_defaults):
                for k in range(len(values)):
                    yield from self._listed(values, k, inside)
        for k in range(len(node.decorator_list)):
            if isinstance(node.decorator_list[k], ast.Call):
                yield from self._listed(node.decorator_list, k, inside)
        yield from self._body(node.body, inside, docstring=True)

    def _handler(self, node: ast.ExceptHandler, where: str) -> Iterator[_Change]:
        if not (len(node.body) == 1 and isinstance(node.body[0], ast.Raise)):
            yield _Change(
                node, where, node.lineno, _text(node).split(":")[0] + ":",
                _replace(node, "body", [ast.Raise()]), "raise",
            )  # fmt: skip
        yield from self._body(node.body, where)

    def _condition(self, node: ast.If | ast.While | ast.IfExp, where: str) -> Iterator[_Change]:
        """Only of what is not changed elsewhere: comparisons, `not`, `and`, `or`."""
        if not isinstance(node.test, ast.Compare | ast.BoolOp | ast.UnaryOp | ast.Constant):
            new = ast.UnaryOp(ast.Not(), node.test)
            yield _Change(
                node, where, node.lineno, f"if {_text(node.test)}", _replace(node, "test", new),
                f"if {_text(new)}",
            )  # fmt: skip

    # Expressions: `_expression` changes a field of a node, `_listed` an item of a list.

    def _expression(self, parent: ast.AST, field: str, where: str) -> Iterator[_Change]:
        node = getattr(parent, field)
        yield from self._changes_of(node, where, lambda new: _replace(parent, field, new))

    def _listed(self, nodes: list, index: int, where: str) -> Iterator[_Change]:
        if nodes[index] is not None:
            yield from self._changes_of(nodes[index], where, lambda new: _replace_in(nodes, index, [new]))

    def _changes_of(self, node: ast.expr, where: str, put: Callable) -> Iterator[_Change]:
        for new in _others(node):
            yield _Change(node, where, node.lineno, _text(node), put(new), _text(new))
        if isinstance(node, ast.BinOp):
            yield from self._operator(node, where)
        if isinstance(node, ast.IfExp):
            yield from self._condition(node, where)
        if isinstance(node, ast.Call):
            yield from self._call(node, where)
            return
        for child, value in ast.iter_fields(node):
            if isinstance(value, ast.expr):
                yield from self._expression(node, child, where)
            elif isinstance(value, list):
                for k, item in enumerate(value):
                    if isinstance(item, ast.comprehension):
                        yield from self._expression(item, "iter", where)
                        for n in range(len(item.ifs)):
                            yield from self._listed(item.ifs, n, where)
                    elif isinstance(item, ast.expr) and not (
                        isinstance(node, ast.JoinedStr) and isinstance(item, ast.Constant)
                    ):
                        yield from self._listed(value, k, where)

    def _call(self, node: ast.Call, where: str) -> Iterator[_Change]:
        name = _called(node)
        if name in SWAPPED or name in PLAIN:
            new = SWAPPED.get(name) or PLAIN[name]
            target, field = (node.func, "id") if isinstance(node.func, ast.Name) else (node.func, "attr")
            yield _Change(node, where, node.lineno, _text(node), _replace(target, field, new))
        if name.endswith("Error") or name in ("print", "_tell"):
            return
        if isinstance(node.func, ast.Attribute):
            yield from self._expression(node.func, "value", where)
        for k in range(len(node.args)):
            yield from self._listed(node.args, k, where)
        for k, keyword in enumerate(node.keywords):
            if keyword.arg in SILENT:
                continue
            if keyword.arg is not None:
                yield _Change(node, where, node.lineno, _text(node), _replace_in(node.keywords, k, []))
            yield from self._expression(keyword, "value", where)

    def _operator(self, node: ast.BinOp | ast.AugAssign, where: str) -> Iterator[_Change]:
        if (new := ARITHMETIC.get(type(node.op))) is not None:
            yield _Change(node, where, node.lineno, _text(node), _replace(node, "op", new()))


def _others(node: ast.expr) -> Iterator[ast.expr]:  # noqa: PLR0912 - one branch a kind of expression
    """What may stand in the place of an expression."""
    match node:
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float() as value) if 0 < value < _ROUNDING:
            yield ast.Constant(0.0)
        case ast.Constant(value=float() as value):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.Constant(value=bytes() as value):
            yield ast.Constant(b"?" + value)
        case ast.Constant(value=str() as value) if len(value.split()) < _WORDS:
            yield ast.Constant("?" + value)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.BoolOp(op=op, values=values):
            for k in range(len(values)):
                left = values[:k] + values[k + 1 :]
                yield left[0] if len(left) == 1 else ast.BoolOp(op, left)
        case ast.Compare(left=left, ops=ops, comparators=right):
            for k, op in enumerate(ops):
                for others in (BOUNDARY, NEGATION):
                    if type(op) in others:
                        yield ast.Compare(left, [*ops[:k], others[type(op)](), *ops[k + 1 :]], right)


def _removable(node: ast.stmt) -> bool:
    """Statements whose removal is not just a name that is missing."""
    match node:
        case ast.Expr(value=ast.Constant()):
            return False
        case ast.Expr() | ast.Raise() | ast.Delete() | ast.AugAssign():
            return True
        case ast.Assign(targets=targets):
            stored = [e for t in targets for e in (t.elts if isinstance(t, ast.Tuple) else [t])]
            return any(isinstance(e, ast.Attribute | ast.Subscript) for e in stored)
    return False


def _called(node: ast.Call) -> str:
    match node.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _nothing(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None
