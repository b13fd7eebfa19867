"""Commands for the first minute: demo, new."""

import argparse
import shutil
from collections.abc import Mapping
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import add_command, add_device

DEMO_PART = "metal_workpiece_1"
# A test compares these names with those of `cell.new_cell`.
SURFACES = ("plastic", "dark-plastic", "steel", "aluminium", "card")
UNITS = ("m", "cm", "mm", "inch")
DEMO = """\
Make a demonstration: the configuration of a cell with machined brackets in a bin, a dataset of
three scenes, and a picture of one of them. If the command is stopped, the same command
continues."""
NEW = """\
Write a folder with a commented configuration for a part, and print the commands that use it. The
size of the bin, the number of parts and the rig are fitted to the size of the part. Give a mesh
file of your own with --part, or a built-in part with --builtin."""


def add_commands(commands) -> None:
    def run_demo(options: argparse.Namespace) -> int:
        return _demo(options, commands.choices)

    demo = add_command(commands, "demo", run_demo, "Make a small dataset and a picture of it.")
    demo.description = DEMO
    demo.set_defaults(when_stopped="run the same command again to continue")
    demo.add_argument(
        "--out",
        type=Path,
        default=Path("graycast-demo"),
        help="The folder of the demonstration (default: graycast-demo).",
    )
    add_device(demo)

    new = add_command(commands, "new", _new, "Write a configuration for a part of your own.")
    new.description = NEW
    new.add_argument("folder", type=Path, help="The folder that is made.")
    what = new.add_mutually_exclusive_group(required=True)
    what.add_argument("--part", type=Path, help="An OBJ, PLY, STL or GLB file of the part.")
    what.add_argument("--builtin", help="The name of a built-in part: see graycast parts.")
    new.add_argument(
        "--unit",
        choices=UNITS,
        help="The unit of the mesh file. STL and OBJ files do not state it.",
    )
    new.add_argument(
        "--surface",
        choices=SURFACES,
        default="plastic",
        help="The material of the mesh, which the configuration states (default: plastic).",
    )


def _demo(options: argparse.Namespace, parsers: Mapping[str, argparse.ArgumentParser]) -> int:
    cell, device = options.out / "cell.yaml", ("--device", options.device)
    if not cell.exists():
        _write_cell(options.out, builtin=DEMO_PART, scenes=3)
    for command, product in (("generate", "dataset"), ("preview", "preview.png")):
        words = (str(cell), "--out", str(options.out / product), *device)
        chosen = parsers[command].parse_args(words)
        if code := chosen.run(chosen):
            return code
    print(f"\nOpen {options.out / 'preview.png'}, and look at the commands in {cell}.")
    return 0


def _new(options: argparse.Namespace) -> int:
    _write_cell(
        options.folder,
        builtin=options.builtin,
        mesh=options.part,
        unit=options.unit,
        surface=options.surface,
    )
    path = options.folder / "cell.yaml"
    print(path)
    for line in path.read_text(encoding="utf-8").splitlines()[1:4]:
        print(line.removeprefix("#"))
    return 0


def _write_cell(
    folder: Path,
    *,
    builtin: str | None = None,
    mesh: Path | None = None,
    unit: str | None = None,
    surface: str = "plastic",
    scenes: int = 10,
) -> None:
    """Write the folder of a cell, whole or not at all.

    Raises:
        GraycastError: the folder is in use, or the part cannot be read.
    """
    from ..base.folder import new_folder
    from ..cell.new_cell import new_cell
    from ..world.parts import builtin_part, load_part

    if mesh is None:
        if unit is not None:
            raise GraycastError("--unit belongs to a mesh file: remove it, or give --part")
        assert builtin is not None  # one of the two is given
        part, source, own = builtin_part(builtin), {"builtin": builtin}, None
    else:
        part, notes = load_part(mesh, unit=unit, density_kg_m3=1000.0, friction=0.4)
        for note in notes:
            print(f"note: {mesh}: {note}")
        source, own = {"mesh": mesh.name} | ({} if unit is None else {"unit": unit}), surface
    text = new_cell(folder.as_posix(), part, source, surface=own, scenes=scenes)
    with new_folder(folder) as out:
        (out / "cell.yaml").write_text(text, encoding="utf-8")
        if mesh is not None:
            shutil.copyfile(mesh, out / mesh.name)
