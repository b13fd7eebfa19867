"""Configurations of users: their values, their errors, and the schema for editors."""

import hashlib
import json
import re
from dataclasses import MISSING, fields, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from small_cell import write_cell

from graycast.base.errors import ConfigError
from graycast.base.progress import Stages
from graycast.camera.rig_file import load_scanner
from graycast.camera.rig_file.own import RigModel
from graycast.camera.scanner import preset
from graycast.cell import config as words
from graycast.cell.config import Config, load_config
from graycast.cell.domain.domain_sections import KINDS
from graycast.cell.resolve import file_digests, resolve_cell
from graycast.learn.study_file import read_study
from graycast.rendering import Quality
from graycast.rig.pair import PRESETS
from graycast.robot.pick import load_pick_config, resolve_pick_cell
from graycast.world.parts import Material, builtin_part
from graycast.world.parts.material_section import MaterialSection
from graycast.world.scene import Bin, Environment

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "configs").rglob("*.yaml"))
KEYS = {path: set(yaml.safe_load(path.read_text(encoding="utf-8"))) for path in FILES}
CELLS = [path for path in FILES if "robot" in KEYS[path]]
DESIGNS = [path for path in FILES if "sweeps" in KEYS[path]]
CONFIGS = [path for path in FILES if "parts" in KEYS[path] and path not in CELLS]
STUDIES = [path for path in FILES if "models" in KEYS[path]]
RIGS = [path for path in FILES if "R_cam_proj" in KEYS[path]]
SCHEMA = json.loads(json.dumps(Config.model_json_schema()))  # as an editor reads it


@pytest.fixture(autouse=True)
def quick_wood(monkeypatch):
    """Replace the real wood, which takes a second and is not tested here."""
    monkeypatch.setattr(words, "wood_texture", lambda: np.zeros((2, 2, 3), dtype=np.uint8))


def test_the_repository_contains_example_configurations():
    names = {str(path.relative_to(ROOT / "configs")) for path in CONFIGS}
    assert {"demo.yaml", "own_part.yaml", "paper/metal_workpiece_1.yaml"} <= names
    assert len(FILES) == len(CONFIGS) + len(CELLS) + len(STUDIES) + len(DESIGNS) + len(RIGS)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_commands_at_the_head_of_a_study_name_each_of_its_datasets(path):
    """The commands in the first lines of a study make its datasets, so that it can be run."""
    spec = read_study(path)
    head = "\n".join(line for line in path.read_text().splitlines() if line.startswith("#"))
    sets = {folder for world in spec.tests.values() for folder in world.datasets}
    sets |= {folder for folders in spec.training.values() for folder in folders}
    for folder in sets:
        place = f"out/{folder.parent.name}/"
        assert place + folder.name in head or place + "$part" in head, folder


@pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)
def test_every_robot_cell_in_the_repository_can_be_resolved(path):
    cell = resolve_pick_cell(load_pick_config(path), path.parent)
    assert cell.config.picking.place_m[2] > 0


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_configuration_in_the_repository_can_be_resolved(path):
    config = load_config(path)
    cell = resolve_cell(config, path.parent)
    written = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert len(cell.scene.parts) == len(written["parts"])
    assert config.scenes == written["scenes"]
    low, high = config.count_range
    count = written.get("count", 30)
    assert [low, high] == (count if isinstance(count, list) else [count, count])
    assert config.fill == written.get("fill")
    sections = written.get("scanners", [written])
    for (_, scanner), one in zip(cell.scanners, sections, strict=True):
        if one["rig"] in PRESETS:
            assert scanner.rig.name == one["rig"]
        else:
            assert scanner.rig.name == load_scanner(path.parent / one["rig"]).rig.name
    size = "bin: The bin is 370 x 270 x 140 mm inside, and its floor is 10.0 mm above the table."
    # Meshes cause no other notes.
    assert cell.notes == ((size,) if "mesh" in written.get("bin", {}) else ())


@pytest.mark.parametrize(
    ("name", "read"),
    [("own_part", ["../examples/data/plate.stl"]), ("crate", ["../examples/data/crate.stl"])],
)
def test_the_name_of_a_mesh_is_announced_before_reading(name, read):
    """A mesh of half a million faces takes seconds."""
    path, messages = ROOT / f"configs/{name}.yaml", []
    resolve_cell(load_config(path), path.parent, progress=Stages(messages.append))
    assert messages == [f"reading {mesh}" for mesh in read]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_each_key_in_a_repository_configuration_is_read_with_its_value(path):
    """Each key in a file of ours has the same value in the configuration."""
    config = load_config(path).model_dump(mode="json", exclude_unset=True)
    written = yaml.safe_load(path.read_text(encoding="utf-8"))
    for lamp in written.get("light", {}).get("lamps", ()):  # A value has all its keys.
        lamp.update({"target_m": [0, 0, 0], "size_m": 0.3} | lamp)
    assert as_json(config) == as_json(written)


def as_json(value):
    if isinstance(value, dict):
        return {key: as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


# --- defaults ----------------------------------------------------------------------------------


def least():
    return Config.model_validate({"parts": [{"builtin": "toothpaste"}]})


def test_omitted_sections_equal_the_defaults_of_their_classes():
    """A default is stated in the section and in the value; the two must not differ."""
    config, here = least(), Path()
    scanner, own = words.resolve_scanner(config, here), preset("paper")
    for name in ("code", "sensor", "exposure", "decode", "filters", "faults"):
        assert getattr(scanner, name) == getattr(own, name)
    assert words.resolve_quality(config) == Quality()
    assert words.resolve_environment(config.light.environment, here) == Environment()
    assert words.resolve_material(MaterialSection(), here) == Material()


def test_a_bin_without_settings_has_the_defaults_of_its_class():
    box, notes = words.resolve_bin(least().bin, Path())
    assert notes == ()
    for field in fields(Bin):
        if field.default is not MISSING:
            assert getattr(box, field.name) == field.default, field.name


def test_a_part_s_own_material_is_kept_except_for_the_given_keys(tmp_path):
    own = words.resolve_parts(least(), tmp_path)[0][0]
    section = {"builtin": "toothpaste", "density_kg_m3": 1234.0, "friction": 0.0}
    section["material"] = {"base_color": [0.1, 0.2, 0.3], "roughness": 0.9}
    changed = words.resolve_parts(Config.model_validate({"parts": [section]}), tmp_path)[0][0]
    assert (changed.density_kg_m3, changed.friction) == (1234.0, 0.0)
    look = replace(own.material, base_color=(0.1, 0.2, 0.3), texture=None, roughness=0.9)
    assert changed.material == look
    assert own.material.texture is not None
    assert changed.symmetry == own.symmetry
    assert own.density_kg_m3 != 1234.0
    assert own.friction > 0


def test_a_metal_with_one_changed_key_remains_a_metal(tmp_path):
    """Otherwise it would be white plastic."""
    section = {"builtin": "metal_workpiece_1", "material": {"roughness": 0.2}}
    part = words.resolve_parts(Config.model_validate({"parts": [section]}), tmp_path)[0][0]
    own = builtin_part("metal_workpiece_1").material
    assert part.material == replace(own, roughness=0.2)
    assert own.metallic == 1.0


def test_scaling_a_part_changes_only_its_size(tmp_path):
    """Look, density and rotations stay the same; all lengths are multiplied."""
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:3, 3] = [0.02, 0.0, 0.0]  # a half turn about the line x = 10 mm, y = 0
    axis = {"axis": [0, 0, 1], "point_m": [0.01, 0.0, 0.0]}
    symmetry = {"discrete": [turn.ravel().tolist()], "continuous": [axis]}
    for section in ({"builtin": "toothpaste"}, {"mesh": "box.stl", "unit": "mm"}):
        extra = {"symmetry": symmetry} if "mesh" in section else {}
        own, large = (
            words.resolve_parts(load_config(write_cell(tmp_path, parts=[part])), tmp_path)[0][0]
            for part in (section | extra, section | extra | {"scale": 1.02})
        )
        np.testing.assert_allclose(large.mesh.extent_m, 1.02 * own.mesh.extent_m, rtol=1e-6)
        assert large.mesh.faces is own.mesh.faces or (large.mesh.faces == own.mesh.faces).all()
        assert large.density_kg_m3 == own.density_kg_m3
    np.testing.assert_allclose(large.symmetry.discrete[0][:3, 3], [0.0204, 0, 0], rtol=1e-12)
    assert (large.symmetry.discrete[0][:3, :3] == turn[:3, :3]).all()
    assert large.symmetry.continuous[0][1] == pytest.approx((0.0102, 0.0, 0.0))


@pytest.mark.slow
def test_a_part_s_symmetry_is_stated_as_rotations_or_detected_from_its_shape(tmp_path):
    """The box is off the origin: rotations are about the middle of its own box unless stated."""
    beside = trimesh.creation.box((20.0, 30.0, 60.0)).apply_translation([50.0, 10.0, 0.0])
    beside.export(tmp_path / "beside.stl")
    symmetries = {}
    for name, symmetry in {
        "turns": {"turns": [{"axis": "z", "fold": 2}, {"axis": [3, 0, 0], "fold": 2}]},
        "auto": {"auto": True},
        "none": None,
    }.items():
        part = {"mesh": "beside.stl", "unit": "mm", "symmetry": symmetry}
        (own,), _ = words.resolve_parts(load_config(write_cell(tmp_path, parts=[part])), tmp_path)
        symmetries[name] = own.symmetry.discrete
    assert [len(symmetries[name]) for name in symmetries] == [3, 3, 0]
    for T in symmetries["turns"]:
        assert any(np.allclose(T, other, atol=1e-9) for other in symmetries["auto"])


def test_a_symmetry_s_axis_may_have_any_length(tmp_path):
    part = {"mesh": "box.stl", "unit": "mm", "symmetry": {"continuous": [{"axis": [3, 0, 4]}]}}
    path = write_cell(tmp_path, parts=[part])
    cell = resolve_cell(load_config(path), tmp_path)
    axis, point_m = cell.scene.parts[0].symmetry.continuous[0]
    assert axis == pytest.approx((0.6, 0.0, 0.8), abs=1e-15)
    assert point_m == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_the_rig_is_placed_according_to_the_view_section(tmp_path):
    """The middle of the baseline has the configured distance and tilt from the target."""
    for view, middle_m in (
        ({"distance_m": 0.8, "target_m": [0.1, 0.2, 0.0]}, [0.1, 0.2, 0.8]),
        ({"distance_m": 0.8, "target_m": [0, 0, 0], "tilt_deg": 30}, [0, -0.4, 0.8 * 0.75**0.5]),
        (
            {"distance_m": 0.8, "target_m": [0, 0, 0], "tilt_deg": 30, "azimuth_deg": 90},
            [0.4, 0, 0.8 * 0.75**0.5],
        ),
        ({"distance_m": 0.8}, [0, 0, 0.8 + 0.1 / 3]),
    ):
        cell = resolve_cell(load_config(write_cell(tmp_path, view=view)), tmp_path)
        T, half = cell.scene.T_world_cam, cell.scene.rig.T_cam_proj[:3, 3] / 2
        assert T[:3, :3] @ half + T[:3, 3] == pytest.approx(np.array(middle_m), abs=1e-12)


BOX_BIN = {"material": {"roughness_map": "walls.png"}, "floor": {"texture": "floor.png"}}
MESH_BIN = {"mesh": "bin.stl", "unit": "mm"}
FOLDERS = ("maps/a.hdr", "woods/b.png", "woods/c.jpg", "stones/d.png")


def naming_files(folder, box):
    """Return a configuration that names as many files as possible, and those files' names."""
    clutter = {"mesh": "clutter.stl", "unit": "mm", "material": {"roughness_map": "clutter.png"}}
    path = write_cell(
        folder,
        parts=[{"mesh": "box.stl", "unit": "mm", "material": {"texture": "box.png"}}],
        bin=box,
        table={"texture": "table.png", "roughness_map": "worn.png"},
        light={"environment": {"map": "sky.exr"}},
        domain={
            "kind": "randomized",
            "environment": {"maps": "maps"},
            "bin": {"textures": "woods"},
            "table": {"textures": "stones"},
            "distractors": {"parts": [clutter]},
        },
    )
    of_box = [word for words in box.values() for word in words.values()] if box is BOX_BIN else []
    names = ["box.stl", "box.png", "table.png", "sky.exr", "clutter.stl", "clutter.png", *FOLDERS]
    names += ["worn.png"]
    names += of_box or ["bin.stl"]
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(f"content of {name}".encode())
    return path, names


@pytest.mark.parametrize("box", [BOX_BIN, MESH_BIN], ids=["box", "mesh"])
def test_every_file_named_in_a_configuration_has_a_digest(tmp_path, box):
    """Oracle: the files in the folder. A file without digest could change between two runs."""
    path, names = naming_files(tmp_path, box)
    config = load_config(path)
    before = file_digests(config, tmp_path)
    assert before == {
        name: hashlib.sha256(f"content of {name}".encode()).hexdigest() for name in names
    }
    for name in names:
        (tmp_path / name).write_bytes(b"other content")
        after = file_digests(config, tmp_path)
        assert {key for key in names if after[key] != before[key]} == {name}
        before = after


def test_the_files_that_a_mesh_uses_have_digests(tmp_path):
    """A changed texture of a bin was once accepted by a second run, because no claim had it."""
    clutter = {"mesh": "models/clutter.obj", "unit": "mm"}
    path = write_cell(
        tmp_path,
        bin={"mesh": "models/bin.obj", "unit": "mm"},
        domain={"kind": "randomized", "distractors": {"parts": [clutter]}},
    )
    texts = {"box.stl": "box"}
    for name in ("bin", "clutter"):
        texts[f"models/{name}.obj"] = f"mtllib {name}.mtl\n"
        texts[f"models/{name}.mtl"] = f"newmtl a\nmap_Kd maps/{name}.png\n"
        texts[f"models/maps/{name}.png"] = name
    (tmp_path / "models/maps").mkdir(parents=True)
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    config = load_config(path)
    before = file_digests(config, tmp_path)
    assert before == {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
    }
    for name in texts:
        (tmp_path / name).write_text(texts[name] + "\n# other")
        assert file_digests(config, tmp_path) != before
        (tmp_path / name).write_text(texts[name])


def test_the_tests_of_digests_cover_every_setting_that_names_a_file():
    """A new one must be added to the test above, and to the digests."""
    path_settings = set()

    def look(node, *keys):
        if isinstance(node, dict):
            if node.get("format") == "path":
                path_settings.add((keys[1], keys[3]))
            for key, inner in node.items():
                look(inner, *keys, key)
        elif isinstance(node, list):
            for inner in node:
                look(inner, *keys)

    look(SCHEMA)
    assert path_settings == {
        ("PartSection", "mesh"),
        ("BinSection", "mesh"),
        ("MaterialSection", "texture"),
        ("MaterialSection", "roughness_map"),
        ("EnvironmentSection", "map"),
        ("EnvironmentRanges", "maps"),
        ("BinRanges", "textures"),
        ("SurfaceRanges", "textures"),
    }


def test_a_resolved_cell_has_the_digests_of_its_files(tmp_path):
    path = write_cell(tmp_path)
    digest = hashlib.sha256((tmp_path / "box.stl").read_bytes()).hexdigest()
    assert resolve_cell(load_config(path), tmp_path).file_digests == {"box.stl": digest}


# --- the schema --------------------------------------------------------------------------------


def faults(value, schema, root, where="file"):
    """Return the errors of a value by JSON Schema 2020-12, for the keywords in our schemas."""
    unknown = set(schema) - _WORDS
    assert not unknown, f"{where}: teach this checker {unknown}"
    if "$ref" in schema:
        name = re.fullmatch(r"#/\$defs/(\w+)", schema["$ref"]).group(1)
        return faults(value, root["$defs"][name], root, where)
    if "anyOf" in schema:
        texts = [faults(value, option, root, where) for option in schema["anyOf"]]
        return min(texts, key=len)
    texts = []
    if "type" in schema and not _is(value, schema["type"]):
        return [f"{where} is no {schema['type']}"]
    if "enum" in schema and value not in schema["enum"]:
        texts.append(f"{where} is none of {schema['enum']}")
    if isinstance(value, int | float) and not isinstance(value, bool):
        bounds = {
            "minimum": lambda limit: value >= limit,
            "maximum": lambda limit: value <= limit,
            "exclusiveMinimum": lambda limit: value > limit,
            "exclusiveMaximum": lambda limit: value < limit,
        }
        texts += [f"{where}: {k}" for k, holds in bounds.items()
                  if k in schema and not holds(schema[k])]  # fmt: skip
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            texts.append(f"{where} has {len(value)} items")
        rest = [schema["items"]] * len(value) if "items" in schema else []
        each = [*schema.get("prefixItems", ()), *rest]
        for i, (item, of) in enumerate(zip(value, each, strict=False)):
            texts += faults(item, of, root, f"{where}.{i}")
    if isinstance(value, dict):
        known = schema.get("properties", {})
        texts += [f"{where}.{key} is missing" for key in schema.get("required", ())
                  if key not in value]  # fmt: skip
        for key, item in value.items():
            if key in known:
                texts += faults(item, known[key], root, f"{where}.{key}")
            elif schema.get("additionalProperties", True) is False:
                texts.append(f"{where}.{key} is unknown")
    return texts


_WORDS = set(
    "$ref $defs type anyOf enum const title description default properties required items "
    "prefixItems additionalProperties minItems maxItems minLength minimum maximum "
    "exclusiveMinimum exclusiveMaximum format".split()
)


def _is(value, kind):
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
    if kind in ("integer", "number"):
        return isinstance(value, int if kind == "integer" else int | float) and (
            not isinstance(value, bool)
        )
    return isinstance(value, kinds[kind])


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_schema_accepts_every_configuration(path):
    assert faults(yaml.safe_load(path.read_text(encoding="utf-8")), SCHEMA, SCHEMA) == []


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"scnes": 3}, "file.scnes is unknown"),
        ({"render": {"samples": 0}}, "file.render.samples: minimum"),
        ({"light": {"lamps": [{"cener_m": [0, 0, 1]}]}}, "file.light.lamps.0.center_m is missing"),
        ({"bin": {"inner_m": [0.3, 0.2]}}, "file.bin.inner_m has 2 items"),
        ({"resolution": "high"}, "file.resolution is none of ['small', 'low', 'full']"),
        ({"seed": "many"}, "file.seed is no integer"),
        ({"parts": [{"builtin": "x", "unit": "yard"}]}, "file.parts.0.unit is none of"),
        ({"parts": []}, "file.parts has 0 items"),
    ],
)
def test_the_schema_refuses_every_configuration_that_the_program_refuses(changes, fault):
    content = {"parts": [{"builtin": "toothpaste"}]} | changes
    texts = faults(content, SCHEMA, SCHEMA)
    assert any(fault in text for text in texts), texts
    with pytest.raises(ValueError):
        Config.model_validate(content)


@pytest.mark.parametrize("schema", [SCHEMA, RigModel.model_json_schema()], ids=["config", "rig"])
def test_a_schema_admits_no_unknown_keys_and_is_consistent(schema):
    """Every object refuses unknown keys, requires only keys that it has, and keeps its limits."""
    objects = [schema, *schema.get("$defs", {}).values()]
    assert len(objects) > 1
    for node in objects:
        assert node["type"] == "object"
        assert node["additionalProperties"] is False
        assert set(node.get("required", ())) <= set(node["properties"])
        for key, of in node["properties"].items():
            if "default" in of:
                assert faults(of["default"], of, schema, key) == []


@pytest.mark.slow
def test_every_misspelt_setting_is_refused(tmp_path):
    """Two letters of each key of each section are swapped; the right key is suggested."""
    sections = Config.model_json_schema()
    for name, section in {"": sections, **sections["$defs"]}.items():
        for key in section["properties"]:
            wrong = key[:-2] + key[-1] + key[-2] if key[-1] != key[-2] else key + "x"
            if wrong in section["properties"]:
                continue
            meant = "views?" if (name, key) == ("", "views") else key  # `view` is equally similar
            path = tmp_path / "bad.yaml"
            path.write_text(yaml.safe_dump(_placed(name, {wrong: 1})))
            hint = rf"unknown key \S*{wrong}: did you mean {meant}\?"
            with pytest.raises(ConfigError, match=hint):
                load_config(path)


_PLACES = {
    "": (),
    "FilterSection": ("filters",),
    "FaultSection": ("faults",),
    "PartSection": ("parts", 0),
    "MaterialSection": ("parts", 0, "material"),
    "SymmetrySection": ("parts", 0, "symmetry"),
    "ContinuousSymmetry": ("parts", 0, "symmetry", "continuous", 0),
    "TurnSymmetry": ("parts", 0, "symmetry", "turns", 0),
    "CyclesSection": ("render", "cycles"),
    "LightSection": ("light",),
    "EnvironmentSection": ("light", "environment"),
    "Lamp": ("light", "lamps", 0),
    "DropLimits": ("drop",),
    "DomeSection": ("views", "dome"),
    "PathSection": ("views", "path"),
    "JitterSection": ("views", "jitter"),
    "ScannerEntry": ("scanners", 0),
    "Waypoint": ("motion", "path", 0),
    "PartMotion": ("motion", "parts", 0),
    "AdaptedSection": ("domain", "adapted"),
    "CameraTolerance": ("domain", "adapted", "camera"),
    "BinTolerance": ("domain", "adapted", "bin"),
    "LampTolerance": ("domain", "adapted", "lamps"),
    "PartTolerance": ("domain", "adapted", "parts"),
    "RandomizedSection": ("domain", "randomized"),
    "CameraRanges": ("domain", "randomized", "camera"),
    "EnvironmentRanges": ("domain", "randomized", "environment"),
    "LampRanges": ("domain", "randomized", "lamps"),
    "BinRanges": ("domain", "randomized", "bin"),
    "SurfaceRanges": ("domain", "randomized", "table"),
    "ColorRanges": ("domain", "randomized", "bin", "color"),
    "PartRanges": ("domain", "randomized", "parts"),
    "DistractorRanges": ("domain", "randomized", "distractors"),
}


def _placed(section, content):
    """Return a configuration with `content` in a section."""
    place = _PLACES.get(section, (section.removesuffix("Section").lower(),))
    for step in reversed(place):
        if isinstance(content, dict) and step in (*KINDS, "dome", "path", "jitter"):
            content = {"kind": step} | content
        else:
            content = [content] if step == 0 else {step: content}
    return content if "parts" in content else {"parts": [{"builtin": "toothpaste"}]} | content
