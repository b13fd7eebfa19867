"""Test the reference pages that are generated from the models and the parser."""

import html
import importlib.util
import json
import re
from pathlib import Path
from typing import get_type_hints

import pytest

from graycast.camera.decode import DecodeSpec, FilterSpec, Reason
from graycast.camera.faults import FaultSpec
from graycast.camera.scanner import ExposureSpec
from graycast.camera.sensor import SensorSpec
from graycast.cli.command import _parser
from graycast.rig.pattern import CodeSpec
from graycast.world.parts import MATERIALS

SCRIPT = Path(__file__).resolve().parents[1] / "docs/reference_pages.py"


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("reference_pages", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def parsers(parser):
    """Yield the parser of every command, including the given parser."""
    yield parser
    for action in parser._actions:
        if isinstance(action.choices, dict):
            for command in action.choices.values():
                yield from parsers(command)


def schemas(capsys):
    """Yield each kind of `graycast schema` with its output."""
    schema = next(parser for parser in parsers(_parser()) if parser.prog == "graycast schema")
    for kind in next(action.choices for action in schema._actions if action.dest == "kind"):
        options = _parser().parse_args(["schema", kind])
        options.run(options)
        yield kind, json.loads(capsys.readouterr().out)


def test_every_key_of_every_schema_has_a_row_with_its_description(reference, capsys):
    row = re.compile(r"^\| (?:<[^|]+>|\[)`(\w+)`.* \| (.+) \|$", re.MULTILINE)
    rows = {
        key_and_text for page in reference.pages().values() for key_and_text in row.findall(page)
    }
    for kind, schema in schemas(capsys):
        for section in (schema, *schema.get("$defs", {}).values()):
            for key, node in section.get("properties", {}).items():
                assert node.get("description"), f"{kind}: {section['title']}.{key}"
                assert (key, reference._escaped(node["description"])) in rows, f"{kind}: {key}"


def test_every_command_has_a_chapter_and_every_flag_an_anchor(reference):
    page = reference.pages()["reference/commands.md"]
    all_parsers = list(parsers(_parser()))
    assert len(all_parsers) > 30
    for parser in all_parsers:
        anchor = "-".join(parser.prog.split()[1:])
        assert f'\n## <a id="{anchor or "graycast"}"></a>{parser.prog}\n' in page
        for action in parser._actions:
            for flag in action.option_strings:
                if flag.startswith("--") and flag not in ("--help", "--debug"):
                    assert f'<a id="{anchor}{flag}"></a>' in page, f"{parser.prog} {flag}"


def test_every_material_has_a_row_with_its_numbers(reference):
    """The numbers are read from the table by the headings of its columns."""
    head, _, *lines = (
        reference.pages()["reference/materials.md"].rpartition("| name")[2].split("\n")
    )
    assert head.split(" | ")[1:4] == ["base color", "metallic", "roughness"]
    rows = [re.findall(r"[^|]+", line) for line in lines if line]
    assert [re.search(r"`(.+)`", row[0])[1] for row in rows] == [*MATERIALS]
    for row, preset in zip(rows, MATERIALS.values(), strict=True):
        _, color, metallic, roughness, grooves, density, source = map(str.strip, row)
        material = preset.material
        assert tuple(map(float, color.split())) == material.base_color
        assert float(metallic) == material.metallic
        film = "" if material.film is None else f", film {material.film:g}"
        rough, *finish = roughness.split(", diffuse ")
        assert rough == ("smooth" if material.transparent else f"{material.roughness:g}{film}")
        numbers = [float(n) for n in re.findall(r"[\d.]+", "".join(finish))]
        stated = [material.diffuse, material.mottle, 1e3 * material.mottle_length_m]
        assert numbers == (pytest.approx(stated) if material.diffuse else [])
        assert float(grooves.removesuffix(", turned") or 0) == material.anisotropy
        turned = material.grain is not None and material.grain.turned
        assert grooves.endswith("turned") == turned
        color_source, _, surface = source.partition("; surface: ")
        assert (float(density), color_source) == (preset.density_kg_m3, preset.source)
        assert (surface or "our choice") == preset.surface


def test_every_reason_and_every_scanner_setting_has_a_line_in_the_glossary(reference):
    """Oracle: the annotations of the classes themselves, which the page does not read."""
    page = html.unescape(reference.pages()["reference/glossary.md"])
    rows = dict(re.findall(r"^\| <a id=\S+></a>(.+?) \| (.+) \|$", page, re.MULTILINE))
    expected = {reason.name.lower().replace("_", " "): reason.meaning for reason in Reason}
    sections = {"decode": DecodeSpec, "filters": FilterSpec, "faults": FaultSpec, "code": CodeSpec}
    sections |= {"exposure": ExposureSpec, "sensor": SensorSpec}
    for section, spec in sections.items():
        for name, hint in get_type_hints(spec, include_extras=True).items():
            texts = [getattr(each, "description", None) for each in hint.__metadata__]
            about = next(text for text in texts if text)
            link = f"[`{section}.{name}`](rig.md#{section}.{name})"
            expected[name.replace("_", " ")] = f"{link} | {' '.join(about.split())}"
    assert len(expected) > 50
    assert rows == expected
    assert {"settling votes", "fine bits", "hidden sigmas", "raster px", "doubt"} < set(rows)


def test_no_page_has_the_same_anchor_twice(reference):
    for name, page in reference.pages().items():
        anchors = re.findall(r'<a id="(\S+)">', page)
        assert len(anchors) == len(set(anchors)), name


def test_the_pages_in_the_repository_equal_the_output_of_the_program(reference):
    """Without this test, an old name of a key or a flag could stay on the pages of a clone."""
    for place, text in reference.pages().items():
        page = SCRIPT.parent / place
        stored = page.read_text(encoding="utf-8") if page.exists() else ""
        assert stored == text, f"docs/{place} is out of date: run make reference"


def test_each_page_that_claims_to_be_generated_is_generated(reference):
    remark = reference._REMARK.strip()
    own = {
        page.relative_to(SCRIPT.parent).as_posix()
        for page in SCRIPT.parent.rglob("*.md")
        if remark in page.read_text(encoding="utf-8")
    }
    assert own == set(reference.pages())


@pytest.mark.slow
def test_main_rewrites_outdated_pages_and_names_them(reference, tmp_path, monkeypatch, capsys):
    (tmp_path / "reference").mkdir()
    monkeypatch.setattr(reference, "__file__", str(tmp_path / "reference_pages.py"))
    reference.main()
    assert set(capsys.readouterr().out.split()) == {f"docs/{name}" for name in reference.pages()}
    old = tmp_path / "reference/stack.md"
    old.write_text(old.read_text().replace("frame", "fram", 1))
    reference.main()
    assert capsys.readouterr().out == "docs/reference/stack.md\n"
    assert old.read_text() == reference.pages()["reference/stack.md"]
