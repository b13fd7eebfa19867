"""Writes the pages of the reference that come from the program: `python docs/reference_pages.py`.

Keys come from the models that read the files, and commands from the parser. Every key and every
flag is an anchor: `configuration.md#bin.inner_m`, `commands.md#dataset-stats--out`. The pages are
part of the repository, so that their links lead somewhere in a clone and on the site of a forge;
`tests/test_reference_pages.py` fails while they are out of date.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from textwrap import dedent
from typing import Any

from graycast.base.settings import allowed_values, setting_description
from graycast.camera.decode import Reason
from graycast.camera.rig_file.own import RigModel
from graycast.camera.scanner import Scanner
from graycast.camera.stack.description import StackDescription
from graycast.cell.config import Config
from graycast.cli.command import _parser
from graycast.learn.study_file import StudySpec
from graycast.robot.pick.bin.pick_sections import PickConfig
from graycast.score.design.study import DesignSpec
from graycast.world.parts import MATERIALS
from graycast.world.parts.material_presets import OUR_CHOICE, MaterialPreset

Schema = dict[str, Any]

_FILES = (
    ("rig", "# Keys of a rig file", RigModel, ""),
    (
        "configuration",
        "# Keys of a configuration\n\nWithout a key of code, exposure, sensor, decode, filters or "
        "faults, the rig's own value is used.",
        Config,
        "",
    ),
    (
        "robot",
        "# Keys of a robot's cell and of a tool\n\nA robot's cell has all [keys of a "
        "configuration](configuration.md) but `domain`, and these. The file of a tool has the keys "
        "of `tool`.",
        PickConfig,
        "",
    ),
    ("stack", "# Keys of a stack file", StackDescription, ""),
    ("study", "# Keys of studies\n\n## Detector study", StudySpec, "detector."),
    ("study", "## Design study", DesignSpec, "design."),
)
_MATERIALS = """\
# Materials by name

`material: brass` is one of them, and `{preset: brass, roughness: 0.4}` changes one
[key](configuration.md#table). Grooves run along x of the mesh, or about its z
if *turned*; `grain` and `turned` change that. The model is
[explained](../explanation/light.md#materials).

![Materials on a ball and a ring, under a lamp and under stripes](../images/materials.jpg)

Each lies under a lamp, in colour, and under projected stripes, as a monochrome scanner sees it, in
one exposure; `python -m benchmarks swatches` draws the picture.

The colour of a metal is the reflectance of its clean, smooth surface at normal incidence, at 610,
550 and 465 nm, from published indices; a measured colour is the reflectance at these wavelengths.
The colour of glass, PMMA and PET is what 10 mm leave of the light; their source is of the index.
Real parts are darker by films of oxide: compare with yours. All other numbers are
our choice, except where *surface* names a source. *Diffuse* is the scattered share of a metal's
light, *mottle* its relative spread of reflectance, over a length.

| name | base color | metallic | roughness | anisotropy | density kg/m³ | source of the colour |
|---|---|---|---|---|---|---|
"""
_GLOSSARY = """\
# Glossary

The words of pictures and pages. `graycast report` and `graycast live` show these lines as tooltips.

## Why a pixel has no depth

| reason | meaning |
|---|---|
"""
_SETTINGS = """
## Settings of a scanner

Rig files and configurations have them.

| setting | key | meaning |
|---|---|---|
"""
# It stands below the title, because MkDocs takes the title from the first line.
_REMARK = "\n\n<!-- `make reference` writes this page from the program. Do not edit it. -->"
_TABLE = "| key | value | default | meaning |\n|---|---|---|---|\n"
_ESCAPED = str.maketrans({c: f"&#{ord(c)};" for c in "|<>*[]{}"})


def pages() -> dict[str, str]:
    """Each page's Markdown by its path in docs."""
    keys = _Keys()
    commands = "".join(_commands(_parser(), "graycast"))
    texts = {"commands": f"# Commands\n\nEvery command takes `--help` and `--debug`.\n\n{commands}"}
    for page, head, model, prefix in _FILES:
        schema = model.model_json_schema()
        if model is RigModel:
            _state_defaults(schema)
        elif model is PickConfig:
            for key in Config.model_fields:
                del schema["properties"][key]
        texts[page] = f"{texts.get(page, '')}{head}\n\n{keys.text(page, schema, prefix)}"
    texts["materials"] = _MATERIALS + "".join(_material(*item) for item in MATERIALS.items())
    texts["glossary"] = "".join(_glossary())
    return {
        f"reference/{name}.md": f"{text.replace(chr(10), _REMARK + chr(10), 1).rstrip()}\n"
        for name, text in texts.items()
    }


def main() -> None:
    """Write each page to its place in docs, and print the paths of those that changed."""
    for place, text in pages().items():
        path = Path(__file__).parent / place
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(f"docs/{place}")


def _anchor(name: str) -> str:
    """Return an anchor that MkDocs and the sites of forges know."""
    return f'<a id="{name}"></a>'


def _material(name: str, preset: MaterialPreset) -> str:
    material = preset.material
    color = " ".join(f"{level:.3f}" for level in material.base_color)
    grooves = f"{material.anisotropy:g}" if material.grain else ""
    if material.grain is not None and material.grain.turned:
        grooves += ", turned"
    rough = "smooth" if material.transparent else f"{material.roughness:g}"
    if material.film is not None:
        rough += f", film {material.film:g}"
    if material.diffuse > 0:
        rough += f", diffuse {material.diffuse:g}"
    if material.mottle > 0:
        rough += f", mottle {material.mottle:g} over {1e3 * material.mottle_length_m:g} mm"
    numbers = f"{material.metallic:g} | {rough} | {grooves}"
    density = f"{preset.density_kg_m3:g}"
    source = preset.source
    if preset.surface != OUR_CHOICE:
        source += f"; surface: {preset.surface}"
    return f"| {_anchor(name)}`{name}` | {color} | {numbers} | {density} | {source} |\n"


def _glossary() -> Iterator[str]:
    """A line for each reason and for each setting of a scanner, in alphabetical order each."""
    yield _GLOSSARY
    for reason in sorted(Reason, key=lambda reason: reason.words):
        place = _anchor(reason.label.replace("_", "-"))
        yield f"| {place}{reason.words} | {_escaped(reason.meaning)} |\n"
    yield _SETTINGS
    paths = [
        f"{section.name}.{field.name}"
        for section in fields(Scanner)
        if callable(section.default_factory)
        for field in fields(section.default_factory())
    ]
    for path in sorted(paths, key=lambda path: path.partition(".")[2]):
        section, _, name = path.partition(".")
        words, place = name.replace("_", " "), _anchor(f"{section}-{name.replace('_', '-')}")
        about = _escaped(setting_description(RigModel, path))
        yield f"| {place}{words} | [`{path}`](rig.md#{path}) | {about} |\n"


def _state_defaults(schema: Schema) -> None:
    """A rig file without a key of these sections has the scanner's default."""
    for field in fields(Scanner):
        if callable(field.default_factory):
            section = schema["properties"][field.name]["$ref"].rsplit("/", 1)[1]
            for key, value in asdict(field.default_factory()).items():
                schema["$defs"][section]["properties"][key]["default"] = value


class _Keys:
    """Tables of keys, one a section; a section that several pages share stands on the first."""

    def __init__(self) -> None:
        self._place: dict[str, str] = {}

    def text(self, page: str, schema: Schema, prefix: str) -> str:
        """The table of a file, and then those of its sections."""
        self._page, self._defs = page, schema.get("$defs", {})
        self._todo: list[tuple[str, Schema]] = []
        text = self._table(schema, prefix)
        while self._todo:
            anchor, section = self._todo.pop(0)
            about = _escaped(section["description"])
            text += f"## {_anchor(anchor)}`{anchor}`\n\n{about}\n\n"
            text += self._table(section, f"{anchor}.")
        return text

    def _table(self, section: Schema, prefix: str) -> str:
        text, required = _TABLE, section.get("required", ())
        for key, node in sorted(section["properties"].items(), key=lambda k: k[0] not in required):
            name = prefix + key
            kind = self._kind(node, name)
            is_section = f"{self._page}.md#{name}" in self._place.values()
            own = f"[`{key}`](#{name})" if is_section else f"{_anchor(name)}`{key}`"
            default = "must be given" if key in required else _default(node)
            text += f"| {own} | {kind} | {default} | {_escaped(node['description'])} |\n"
        return text + "\n"

    def _kind(self, node: Schema, name: str) -> str:
        """What a value may be, in words, with a link to a section's own table."""
        if "$ref" in node:
            section = self._defs[node["$ref"].rsplit("/", 1)[1]]
            return self._link(section, name)
        for several in ("anyOf", "oneOf"):
            if several in node:
                chosen = [option for option in node[several] if option != {"type": "null"}]
                kinds = [self._kind(option, name) for option in chosen]
                empty = len(chosen) < len(node[several]) and node.get("default") is not None
                return " or ".join(dict.fromkeys(kinds + ["null"] * empty))
        if node.get("enum") == [*MATERIALS]:
            return "[name](materials.md)"
        if "enum" in node or "const" in node:
            return ", ".join(f"`{word}`" for word in node.get("enum", [node.get("const")]))
        if "prefixItems" in node:
            kinds = [self._kind(item, name) for item in node["prefixItems"]]
            alike = len(set(kinds)) == 1
            return f"{len(kinds)} x {kinds[0]}" if alike else f"[{', '.join(kinds)}]"
        if "items" in node:
            return f"list of {self._kind(node['items'], name)}"
        if "additionalProperties" in node:
            return f"names, each with {self._kind(node['additionalProperties'], name)}"
        return _escaped(allowed_values(node))

    def _link(self, section: Schema, name: str) -> str:
        keys = section["properties"]
        kind = keys.get("kind", {}).get("const")
        content = json.dumps({key: node | {"default": None} for key, node in keys.items()})
        if content not in self._place:
            anchor = f"{name}.{kind}" if kind else name
            self._place[content] = f"{self._page}.md#{anchor}"
            self._todo.append((anchor, section))
        return f"[{kind or 'section'}]({self._place[content]})"


def _default(node: Schema) -> str:
    value = node.get("default")
    inner = value[0] if isinstance(value, list | tuple) and value else value
    return "" if value is None or isinstance(inner, dict) else f"`{json.dumps(value)}`"


def _escaped(text: str) -> str:
    return " ".join(text.split()).translate(_ESCAPED)


def _commands(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
    """A chapter for each command; those of a group's commands follow it."""
    anchor = name.removeprefix("graycast").strip().replace(" ", "-")
    example, _, about = (parser.description or "").rpartition("\n\n")
    yield f"## {_anchor(anchor or 'graycast')}{name}\n\n{_escaped(about)}\n\n"
    if example:
        yield f"```sh\n{dedent(example.partition(chr(10))[2])}\n```\n\n"
    groups = [action for action in parser._actions if isinstance(action.choices, dict)]
    shown = [a for a in parser._actions if a not in groups and a.dest not in ("help", "debug")]
    if shown:
        yield "| argument | meaning |\n|---|---|\n"
        yield "".join(_argument(parser, action, anchor) for action in shown) + "\n"
    for group in groups:
        for word, command in group.choices.items():
            yield from _commands(command, f"{name} {word}")


def _argument(parser: argparse.ArgumentParser, action: argparse.Action, anchor: str) -> str:
    formatter = parser._get_formatter()
    flag = (action.option_strings or [""])[-1]
    value = formatter._format_args(action, action.dest.upper() if flag else action.dest)
    place = f"{anchor}{flag or '-' + action.dest}"
    words = f"{flag} {value}".strip()
    return f"| {_anchor(place)}`{words}` | {_escaped(_help(formatter, action))} |\n"


def _help(formatter: argparse.HelpFormatter, action: argparse.Action) -> str:
    return formatter._expand_help(action) if action.help else ""


if __name__ == "__main__":
    main()
