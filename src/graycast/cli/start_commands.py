"""Commands to get started (demo, new) and for reference (doctor, schema)."""

import argparse
import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import GraycastError
from .arguments import CONTINUE, add_command, add_device, add_option, add_shared

if TYPE_CHECKING:
    from ..world.parts import Part

DEMO_PART = "metal_workpiece_1"
METAL_KG_M3, OTHER_KG_M3 = 7850.0, 1000.0  # Defaults: the densities of steel and of water.
DEMO = """\
It writes the configuration of a cell with machined brackets in a bin, a dataset of three scenes,
and a picture of one of them. If the command is stopped, the same command continues."""
NEW = """\
The command prints the commands that use the configuration. The size of the part decides the size of
the bin, the number of parts, the rig and its distance, at which the bin fills the picture. Give a
mesh file of your own with --part, or a built-in part with --builtin."""
KINDS = ("config", "rig", "stack", "study", "design", "robot", "tool")


def add_first(commands) -> None:
    def run_demo(options: argparse.Namespace) -> int:
        return _demo(options, commands.choices)

    demo = add_command(
        commands, "demo", run_demo, "Make a small dataset and a picture of it.",
        example="", more=DEMO, when_stopped=CONTINUE,
    )  # fmt: skip
    add_option(demo, "--out", Path, "The folder of the demonstration.", Path("graycast-demo"))
    add_device(demo)

    new = add_command(
        commands, "new", _new, "Write a configuration for a part of your own.",
        example="bracket --part bracket.stl --unit mm", more=NEW,
    )  # fmt: skip
    add_option(new, "folder", Path, "The folder that is made.")
    what = new.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--part", type=Path, metavar="PATH", help="An OBJ, PLY, STL, GLB or STEP file of the part."
    )
    what.add_argument(
        "--builtin", metavar="NAME", help="The name of a built-in part: see graycast parts."
    )
    add_shared(new, "--unit")
    look = new.add_mutually_exclusive_group()
    look.add_argument(
        "--surface",
        metavar="NAME",
        help="The name of the material of the part, such as steel-brushed; a wrong name lists them "
        "(default: plastic, or the part's own look).",
    )
    look.add_argument(
        "--surface-from",
        type=Path,
        metavar="FILE",
        help="The material that graycast real material fitted to a scan of the part.",
    )


def add_last(commands) -> None:
    add_command(
        commands, "doctor", _doctor, "List what Graycast can use on this machine.", example="",
        more="It lists also what is missing, and what each missing piece is for.",
    )  # fmt: skip
    schema = add_command(
        commands, "schema", _schema, "Print the JSON Schema of a kind of file.",
        example="config > cell.schema.json", more="Editors complete and check files with it.",
    )  # fmt: skip
    add_option(schema, "kind", KINDS, "The kind of file.")


def _demo(options: argparse.Namespace, parsers: Mapping[str, argparse.ArgumentParser]) -> int:
    cell, device = options.out / "cell.yaml", ("--device", options.device)
    if not cell.exists():
        _write_cell(options.out, builtin=DEMO_PART, scenes=3)
    for command, product in (("generate", "dataset"), ("preview", "preview.png")):
        words = (str(cell), "--out", str(options.out / product), *device)
        inner = parsers[command].parse_args(words)
        if code := inner.run(inner):
            return code
    print(f"\nOpen {options.out / 'preview.png'}, and look at the commands in {cell}.")
    return 0


def _new(options: argparse.Namespace) -> None:
    from ..world.parts import mass_text, size_text, unusual_size_note

    part = _write_cell(
        options.folder,
        builtin=options.builtin,
        mesh=options.part,
        unit=options.unit,
        surface=options.surface,
        surface_from=options.surface_from,
    )
    path = options.folder / "cell.yaml"
    print(f"{part.name}: {size_text(part)} mm, {mass_text(part)}")
    if note := unusual_size_note(part):
        print(f"note: {note}")
    print(path)
    for line in path.read_text(encoding="utf-8").splitlines()[1:5]:
        print(line.removeprefix("# "))


def _write_cell(
    folder: Path,
    *,
    builtin: str | None = None,
    mesh: Path | None = None,
    unit: str | None = None,
    surface: str | None = None,
    surface_from: Path | None = None,
    scenes: int = 10,
) -> "Part":
    """Write the folder of a cell completely or not at all, and return its part.

    Raises:
        GraycastError: the folder is not empty or cannot be written, or the part cannot be read.
    """
    from ..base.folder import new_folder
    from ..cell.new_cell import fitted_surface, named_surface, new_cell
    from ..world.parts import builtin_part, files_of_mesh, glass_notes, load_part

    own = None if surface is None else named_surface(surface)
    if surface_from is not None:
        own = fitted_surface(surface_from)
    if mesh is None:
        if unit is not None:
            raise GraycastError("--unit belongs to a mesh file: remove it, or give --part")
        assert builtin is not None  # exactly one of the two is given
        part, source = builtin_part(builtin), {"builtin": builtin}
    else:
        material = None if own is None else own.material
        metal = material is not None and material.metallic > 0
        density_kg_m3 = METAL_KG_M3 if metal else OTHER_KG_M3
        part, notes = load_part(
            mesh, unit=unit, material=material, density_kg_m3=density_kg_m3, friction=0.4
        )
        for note in (*notes, *glass_notes([part])):
            print(f"note: {mesh}: {note}")
        if own is None and part.material.texture is None:
            own = named_surface("plastic")
        source = {"mesh": mesh.name} | ({} if unit is None else {"unit": unit})
    text = new_cell(folder.as_posix(), part, source, surface=own, scenes=scenes)
    with new_folder(folder) as out:
        (out / "cell.yaml").write_text(text, encoding="utf-8")
        if mesh is not None:
            for file in (mesh, *files_of_mesh(mesh)):
                copy = out / file.relative_to(mesh.parent)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, copy)
    if own is None or own.density_kg_m3 is None:
        return part
    return replace(part, density_kg_m3=own.density_kg_m3)


def _doctor(options: argparse.Namespace) -> None:
    from .doctor import describe, examine

    print(describe(examine()))


def _schema(options: argparse.Namespace) -> None:
    from ..camera.rig_file.own import RigModel
    from ..camera.stack import StackDescription
    from ..cell.config import Config
    from ..learn.study_file import StudySpec
    from ..robot.grasp_labels.label_options import ToolFile
    from ..robot.pick.bin.pick_sections import PickConfig
    from ..score.design.study import DesignSpec

    models: tuple[Any, ...] = (
        Config, RigModel, StackDescription, StudySpec, DesignSpec, PickConfig, ToolFile,
    )  # fmt: skip
    model = dict(zip(KINDS, models, strict=True))[options.kind]
    print(json.dumps(model.model_json_schema(), indent=2))
