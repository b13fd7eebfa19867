"""A new cell fits its part: its configuration is valid, the bin is in view, the heap has room."""

import shlex
from functools import partial
from typing import get_args

import numpy as np
import pytest
import trimesh
import yaml
from backends import slow

from graycast.base.errors import ConfigError
from graycast.base.frames import UNITS_M
from graycast.cell.config import load_config
from graycast.cell.framing import SCANNERS, best_framing, bin_share, part_width_px
from graycast.cell.new_cell import bin_for, fitted_surface, framing_text, new_cell
from graycast.cell.resolve import resolve_cell
from graycast.cli.command import main
from graycast.world.parts import MATERIALS, Material, builtin_part, load_part
from graycast.world.parts.material_section import MaterialSection, resolve_material
from graycast.world.parts.part_sections import Unit, resolve_part
from graycast.world.scene import Bin


def test_a_new_configuration_lists_all_units():
    assert set(get_args(Unit)) == set(UNITS_M)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [slow("a: b #1.stl"), 'it\'s "big" {v2}.stl', slow("größe, 5 %.stl")]
)
def test_a_new_cell_s_mesh_and_folder_may_have_any_name(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.02, 0.03, 0.06)).export("block.stl")
    (tmp_path / "block.stl").rename(tmp_path / name)
    assert main(["new", "a cell", "--part", name, "--unit", "m"]) == 0
    _, _, *commands, _ = capsys.readouterr().out.splitlines()
    assert [shlex.split(line)[2] for line in commands] == 3 * ["a cell/cell.yaml"]
    cell = resolve_cell(load_config(tmp_path / "a cell/cell.yaml"), tmp_path / "a cell")
    assert cell.scene.parts[0].source == name


@pytest.mark.slow
@pytest.mark.parametrize("surface", ["plastic", "steel", "cardboard"])
def test_a_new_cell_file_is_read_with_the_values_that_were_written(tmp_path, monkeypatch, surface):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.02, 0.03, 0.06)).export(tmp_path / "block.stl")
    words = ["new", "cell", "--part", "block.stl", "--unit", "m", "--surface", surface]
    assert main(words) == 0
    config = load_config(tmp_path / "cell/cell.yaml")
    cell = resolve_cell(config, tmp_path / "cell")
    (part,) = cell.scene.parts
    preset = MATERIALS[surface]
    assert (part.density_kg_m3, part.material) == (preset.density_kg_m3, preset.material)
    assert cell.scanner.exposure.auto == (surface == "steel")  # a metal needs a wide bracket
    assert len(part.symmetry.discrete) == 3
    assert cell.scene.bin.inner_m == (0.3, 0.22, 0.11) and cell.notes == ()
    # The limit is a third of the blocks that fill half of the bin's volume, as this is below 60.
    least, most = config.count
    full = 0.5 * 0.3 * 0.22 * 0.11 / (0.02 * 0.03 * 0.06)
    assert most == round(round(full) / 3) and least == most // 2


FITTED = """\
# Fitted to scan, scanned by like-phoxi-m with 637 nm: 3000 pixels.
base_color: [0.41, 0.41, 0.41]  # 0.39 to 0.43, at the projector's wavelength
metallic: 1.0
roughness: 0.44  # 0.42 to 0.46
specular: 0.5
"""
PLASTIC = FITTED.replace("metallic: 1.0", "metallic: 0.0")


@pytest.mark.parametrize(
    ("content", "metallic"), [(FITTED, 1.0), (PLASTIC, 0.0)], ids=["metal", "plastic"]
)
def test_a_fitted_surface_is_in_the_cell_with_its_intervals(
    tmp_path, monkeypatch, content, metallic
):
    one = partial(best_framing, names=["like-phoxi-m"])  # The choice of all scanners takes longer.
    monkeypatch.setattr("graycast.cell.new_cell.best_framing", one)
    (tmp_path / "fit.yaml").write_text(content)
    trimesh.creation.box((20, 30, 60)).export(tmp_path / "block.stl")
    block, _ = load_part(tmp_path / "block.stl", unit="mm", density_kg_m3=2700.0, friction=0.4)
    source = {"mesh": "block.stl", "unit": "mm"}
    text = new_cell("cell", block, source, surface=fitted_surface(tmp_path / "fit.yaml"))
    (tmp_path / "cell.yaml").write_text(text)
    config = load_config(tmp_path / "cell.yaml")
    part, _ = resolve_part(config.parts[0], tmp_path)
    fit = Material(base_color=(0.41,) * 3, metallic=metallic, roughness=0.44, specular=0.5)
    assert part.material == fit
    assert part.density_kg_m3 == 2700  # a scan does not determine it
    assert ("exposure: {auto: true}" in text) == (metallic == 1)  # metal needs a wide bracket
    for comment in ("scanned by like-phoxi-m with 637 nm: 3000 pixels.", "# 0.42 to 0.46"):
        assert comment in text


@pytest.mark.parametrize(
    "content",
    [
        f"---\n{FITTED}...\n",
        f"\ufeff{FITTED}",
        FITTED.replace("\n", "\r\n"),
        "{base_color: [0.41, 0.41, 0.41],\n metallic: 1.0, roughness: 0.44}",
        "  base_color: [0.41, 0.41, 0.41]\n  metallic: 1.0\n\n  roughness: 0.44",
    ],
    ids=["document marks", "byte order mark", "lines of Windows", "braces", "indented"],
)
def test_a_fitted_material_may_be_saved_again_by_an_editor(tmp_path, content):
    (tmp_path / "fit.yaml").write_bytes(content.encode())
    surface = fitted_surface(tmp_path / "fit.yaml")
    entry = "\n  ".join(["- mesh: a.stl", *surface.lines])
    (section,) = yaml.safe_load(entry)
    assert section["material"].items() >= {"roughness": 0.44, "metallic": 1.0}.items()
    assert surface.material == resolve_material(MaterialSection(**section["material"]), tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (FITTED.replace("roughness:", "# roughness:"), "has no roughness, so the scan did not"),
        (FITTED.replace("base_color:", "# base_color:"), "has no base_color, so the scan did not"),
        (FITTED.replace("metallic:", "# metallic:"), "has no metallic, so the scan did not"),
        ("preset: steel\n", "is no fitted material, which has the keys base_color, metallic"),
        ("", "holds no keys"),
        (FITTED + "texture: print.png\n", "texture names a picture"),
        (FITTED + "parts: []\n", "unknown key parts"),
        (FITTED + "anisotropy: 0.5\n", "anisotropy is 0.5, which needs"),
        (FITTED.replace("0.44", "4.4"), "roughness is 4.4"),
        (FITTED.replace("0.41]", "0.41"), "is not YAML in line"),
        ("--- # a fit\n" + FITTED, "is not YAML in line 3"),
        (
            FITTED.replace("metallic", "# metallic").replace("base", "# base"),
            "has no base_color and no metallic, so the scan did not",
        ),
    ],
)
def test_a_file_without_a_complete_material_is_refused(tmp_path, content, message):
    (tmp_path / "fit.yaml").write_text(content)
    with pytest.raises(ConfigError, match=f"fit.yaml: .*{message}"):
        fitted_surface(tmp_path / "fit.yaml")


def test_only_one_surface_is_accepted(capsys):
    words = ["new", "a", "--builtin", "toothpaste", "--surface", "steel", "--surface-from", "f"]
    with pytest.raises(SystemExit):
        main(words)
    assert "--surface-from: not allowed with argument --surface" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "density_kg_m3", "mass"),
    [(FITTED, 7850, "283 g"), (PLASTIC, 1000, "36 g")],
    ids=["metal", "plastic"],
)
def test_a_mesh_with_a_fitted_metal_is_as_heavy_as_steel(
    tmp_path, monkeypatch, capsys, content, density_kg_m3, mass
):
    """Oracle: the masses of 36 cm^3 of steel and of water."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fit.yaml").write_text(content)
    trimesh.creation.box((20, 30, 60)).export("block.stl")
    words = ["new", "cell", "--part", "block.stl", "--unit", "mm", "--surface-from", "fit.yaml"]
    assert main(words) == 0
    assert f"60.0 mm, {mass}" in capsys.readouterr().out
    cell = resolve_cell(load_config(tmp_path / "cell/cell.yaml"), tmp_path / "cell")
    (part,) = cell.scene.parts
    assert part.material == fitted_surface(tmp_path / "fit.yaml").material
    assert part.density_kg_m3 == density_kg_m3
    assert cell.scanner.exposure.auto == (density_kg_m3 == 7850)


@pytest.mark.slow
def test_a_builtin_part_with_a_fitted_surface_keeps_its_density(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fit.yaml").write_text(FITTED)
    assert main(["new", "cell", "--builtin", "toothpaste", "--surface-from", "fit.yaml"]) == 0
    (part,) = resolve_cell(load_config(tmp_path / "cell/cell.yaml"), tmp_path).scene.parts
    own = builtin_part("toothpaste")
    assert (part.density_kg_m3, part.material.metallic) == (own.density_kg_m3, 1.0)


def test_a_builtin_part_gets_the_requested_surface(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "cell", "--builtin", "toothpaste", "--surface", "steel"]) == 0
    assert "material: steel" in (tmp_path / "cell/cell.yaml").read_text()


@pytest.mark.slow
def test_the_printed_line_about_a_new_cell_is_correct(tmp_path, monkeypatch, capsys):
    """Oracle: the share and the width that the configuration itself gives, at two resolutions."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.02, 0.03, 0.044)).export("block.stl")
    assert main(["new", "cell", "--part", "block.stl", "--unit", "m"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    config = load_config(tmp_path / "cell/cell.yaml")
    widths = []
    for resolution in ("full", "small"):
        scaled = config.model_copy(update={"resolution": resolution})
        scene = resolve_cell(scaled, tmp_path / "cell").scene
        camera, box = scene.rig.camera, scene.bin
        widths.append(part_width_px(scene.parts[0], camera, scene.T_world_cam, box))
        share = bin_share(camera, scene.T_world_cam, box)
    assert line == (
        f"{config.rig} at {config.view.distance_m:.2f} m: the bin fills {100 * share:.0f} % of the "
        f"picture, a part is {widths[0]:.0f} px wide at full, {widths[1]:.0f} px at small"
    )
    assert f"# {line}" in (tmp_path / "cell/cell.yaml").read_text()


def test_a_new_cell_without_a_fitting_scanner_names_the_nearest_and_its_shortfall():
    box = Bin(inner_m=(3.0, 2.25, 1.12))
    framing = best_framing(box)
    lacking = f"this one is nearest: it lacks {1e3 * framing.missing_m:.0f} mm"
    assert framing_text(framing, builtin_part("toothpaste"), box).endswith(lacking)


@pytest.mark.parametrize("inner_m", [(0.12, 0.09, 0.05), (0.15, 0.11, 0.06), (0.22, 0.16, 0.08)])
def test_a_note_says_that_a_bin_is_small_for_every_scanner(inner_m):
    """Oracle: the share of each scanner that holds the bin, one by one."""
    box = Bin(inner_m=inner_m)
    fits = [one for name in SCANNERS if (one := best_framing(box, [name])).missing_m <= 0]
    share = max(bin_share(one.rig.camera, one.T_world_cam, box) for one in fits)
    line = framing_text(best_framing(box), builtin_part("toothpaste"), box)
    words = "; this bin is small: with every scanner of the shelf, it fills at most "
    assert line.partition(words)[2] == (
        f"{100 * share:.0f} % of the picture" if share < 0.5 else ""
    )


@pytest.mark.parametrize(("longest_m", "length_m"), [(0.005, 0.12), (0.06, 0.3), (0.4, 1.0)])
def test_a_new_bin_is_five_parts_long_within_the_size_limits(longest_m, length_m):
    part = builtin_part("metal_workpiece_1")
    part = part.scaled(longest_m / float(part.mesh.extent_m.max()))
    np.testing.assert_allclose(bin_for(part), np.array([1, 0.75, 0.375]) * length_m, atol=0.0051)


def test_a_built_in_part_of_a_new_cell_keeps_its_own_surface():
    part = builtin_part("toothpaste")
    assert "material" not in new_cell("a", part, {"builtin": "toothpaste"}, surface=None)


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (["new", "a", "--builtin", "nope"], "no built-in part 'nope': choose one of"),
        (["new", "a", "--builtin", "toothpaste", "--unit", "mm"], "--unit belongs to a mesh"),
        (["new", "a", "--part", "b.stl", "--unit", "mm"], "b.stl: there is no such file"),
        (
            ["new", "a", "--part", "c.stl", "--unit", "m", "--surface", "brss"],
            "no material has the name 'brss'; did you mean brass?",
        ),
        (["new", ".", "--builtin", "toothpaste"], "is not empty: choose another folder"),
    ],
)
def test_a_refused_part_leaves_no_folder_of_a_new_cell(tmp_path, monkeypatch, capsys, words, wrong):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.02, 0.03, 0.06)).export("c.stl")
    assert main(words) == 1 and wrong in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["c.stl"]


@pytest.mark.slow
def test_the_demonstration_makes_a_picture_and_can_be_continued(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--device", "cpu"]) == 0
    assert "Open graycast-demo/preview.png" in capsys.readouterr().out
    assert len(list((tmp_path / "graycast-demo/dataset/train").iterdir())) == 3
    assert main(["demo", "--device", "cpu"]) == 0  # finished scenes are kept


@pytest.mark.parametrize(
    ("sides", "unit", "size", "mass", "note"),
    [
        ((40, 20, 10), "mm", "40.0 x 20.0 x 10.0 mm", "62.8 g", ""),
        ((40, 20, 10), "inch", "1016.0 x 508.0 x 254.0 mm", "1029 kg", "is 1016 mm long, and most"),
        ((4, 2, 1), "mm", "4.0 x 2.0 x 1.0 mm", "0.0628 g", ""),
        ((3, 2, 1), "mm", "3.0 x 2.0 x 1.0 mm", "0.0471 g", "is 3 mm long, and most parts"),
    ],
)
def test_the_new_command_prints_size_and_mass_and_doubts_an_implausible_unit(
    tmp_path, monkeypatch, capsys, sides, unit, size, mass, note
):
    """Oracle: 8 cm^3 of steel weigh 62.8 g, and 25.4^3 times that in inches."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box(sides).export("block.stl")
    assert main(["new", "cell", "--part", "block.stl", "--unit", unit, "--surface", "steel"]) == 0
    text = capsys.readouterr().out
    assert f"block: {size}, {mass}\n" in text
    assert (note in text) if note else ("note:" not in text)
    *commands, scanner = text.splitlines()[-4:]  # Only the commands are indented.
    assert all(line.startswith("  graycast ") for line in commands)
    assert scanner == scanner.strip() and "the bin fills" in scanner
