"""A page for each file format, made from its JSON Schema in docs/schemas/."""

import json
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from generated import plain, write_pages

Schema = dict[str, Any]
_MAX_DEPTH = 12
# Pages that explain a format, where they have another name.
_PAGE_OF_FORMAT = {
    "adaptation": "how-to/adapt",
    "board": "rig",
    "built-scene": "dynamics",
    "design": "evolution",
    "info": "installation",
    "notes": "runs",
    "packet-manifest": "packet",
    "plane": "camera",
    "prices": "packet",
    "printed-run": "evolving-for-building",
    "printed-status": "evolving-for-building",
    "problem-run": "how-to/own-problem",
    "problem-status": "how-to/own-problem",
    "printer": "packet",
    "ranking": "packet",
    "run": "evolution",
    "schedule": "rig",
    "specification": "packet",
    "springs": "rig",
    "status": "evolution",
    "tags": "camera",
    "terrain": "built",
    "trajectory": "vision",
    "transfer": "second-physics",
    **{
        f"benchmark-{name}": "benchmarks"
        for name in ("accuracy", "built", "device", "skips", "speed", "stability")
    },
}


def write(docs: Path) -> None:
    """Write docs/generated/formats/NAME.md for every schema."""
    pages = {}
    for path in sorted((docs / "schemas").glob("*.schema.json")):
        name = path.name.removesuffix(".schema.json")
        pages[name] = "\n\n".join(_page(name, json.loads(path.read_text(encoding="utf-8"))))
    write_pages(docs / "generated" / "formats", pages)


def _page(name: str, schema: Schema) -> Iterator[str]:
    yield f"# {plain(schema['title'])}"
    if description := schema.get("description"):
        yield plain(description)
    kind = schema.get("properties", {}).get("format", {})
    named = kind.get("const") or " or ".join(kind.get("enum", []))
    page = _PAGE_OF_FORMAT.get(name, name)
    elsewhere = page in ("benchmarks", "installation") or "/" in page
    target = f"/{page}.md" if elsewhere else f"/reference/{page}.md"
    yield (
        (f"Explained in [{page.removeprefix('how-to/')}]({target}). ")
        + (f"Format `{named}`. " if named else "")
        + (f"The schema, for programs: {{download}}`{name}.schema.json </schemas/{name}.schema.json>`.")
    )
    yield from _table(schema)
    for title, inner in schema.get("$defs", {}).items():
        yield f"## {title}"
        if description := inner.get("description"):
            yield plain(description)
        yield from _table(inner)


def _table(schema: Schema) -> Iterator[str]:
    rows = list(_rows(schema, "", 0))
    if rows:
        yield "\n".join(["| entry | value | meaning |", "| --- | --- | --- |", *rows])
    else:
        yield f"Value: {_value(schema)}."


def _rows(schema: Schema, above: str, depth: int) -> Iterator[str]:
    """A row for each entry, and for the entries inside it: `gait.phase`, `events[].t_s`."""
    if depth > _MAX_DEPTH:
        return
    required = set(schema.get("required", []))
    entries = [*schema.get("properties", {}).items(), *schema.get("patternProperties", {}).items()]
    others = schema.get("additionalProperties")
    if isinstance(others, dict):
        entries.append(("NAME", others))
    for name, inner in entries:
        path = f"{above}.{name}" if above else name
        meaning = plain(inner.get("description", "One entry for each name." if name == "NAME" else ""))
        default = inner.get("default")
        if default is not None and not isinstance(default, dict):
            meaning += f" Default: `{json.dumps(default)}`."
        elif name not in required and name != "NAME":
            meaning += " Optional."
        yield f"| {_entry_name(path)} | {_value(inner)} | {meaning.strip()} |"
        yield from _inside(inner, path, depth + 1)
    for part in ("allOf", "anyOf", "oneOf"):
        for inner in schema.get(part, []):
            if "properties" in inner and not schema.get("properties"):
                yield from _rows(inner, above, depth + 1)


def _entry_name(path: str) -> str:
    """The name of an entry; a line may end after each of its dots."""
    broken = escape(path).replace("|", "&#124;").replace(".", ".<wbr>")
    return f'<code class="docutils literal path">{broken}</code>'


def _inside(schema: Schema, path: str, depth: int) -> Iterator[str]:
    """Rows of an object, or of the objects in a list."""
    items = schema.get("items")
    if isinstance(items, dict):
        yield from _inside(items, f"{path}[]", depth)
        return
    yield from _rows(schema, path, depth)


def _value(schema: Schema) -> str:
    """The values that a schema allows, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    allowed = schema.get("enum", [schema["const"]] if "const" in schema else [])
    if allowed:
        return ", ".join(f"`{json.dumps(value)}`" for value in allowed)
    for key, word in (("anyOf", " or "), ("oneOf", " or "), ("allOf", " and ")):
        if key in schema:
            return word.join(dict.fromkeys(filter(None, map(_value, schema[key]))))
    kind = schema.get("type", "")
    if isinstance(kind, list):
        return " or ".join(_value({**schema, "type": k}) for k in kind)
    return _array(schema) if kind == "array" else _single(schema, kind)


def _single(schema: Schema, kind: str) -> str:
    words = {"object": "entries", "integer": "whole number", "string": "text", "boolean": "true or false"}
    text = words.get(kind, kind)
    if kind in ("integer", "number"):
        text += _range(schema)
    if "pattern" in schema:
        pattern = schema["pattern"].replace("|", "\\|")
        text += f" like `{pattern}`"
    return text


def _range(schema: Schema) -> str:
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "more than",
        "maximum": "at most",
        "exclusiveMaximum": "less than",
    }
    ends = [f"{word} {schema[key]}" for key, word in words.items() if key in schema]
    return f", {' and '.join(ends)}" if ends else ""


def _array(schema: Schema) -> str:
    if "prefixItems" in schema:
        return "list of " + ", ".join(_value(s) for s in schema["prefixItems"])
    min_items, max_items = schema.get("minItems"), schema.get("maxItems")
    exact = min_items == max_items and min_items
    number = f"{min_items} " if exact else f"at least {min_items} " if min_items else ""
    if max_items and max_items != min_items:
        number = f"{min_items or 0} to {max_items} "
    items = schema.get("items", {})
    return f"list of {number}" + (_value(items) if isinstance(items, dict) and items else "values")
