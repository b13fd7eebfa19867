"""Commands about one scene, a dataset and parts: preview, validate, parts."""

import argparse
from pathlib import Path

from .arguments import (
    add_backend,
    add_command,
    add_config,
    add_device,
    add_seed,
    load_cell,
    print_shares,
    seed,
)
from .bars import open_bars, open_stages

# Heavy modules are imported by the command that needs them, so that --help answers at once.


def add_commands(commands) -> None:
    preview = add_command(
        commands,
        "preview",
        _preview,
        "Make one scene and draw its pictures and its depth on one sheet.",
    )
    add_config(preview)
    preview.add_argument("--out", type=Path, required=True, help="The PNG file to write.")
    preview.add_argument(
        "--scene",
        type=seed,
        default=0,
        help="The number of the scene, counted from 0 (default: 0).",
    )
    preview.add_argument(
        "--image",
        type=seed,
        default=0,
        help="Which of the scene's images to make, of a cell that takes several: all images of its "
        "first scanner, then those of the next (default: 0).",
    )
    add_seed(preview)
    add_backend(preview)
    add_device(preview)

    validate = add_command(
        commands,
        "validate",
        _validate,
        "Check that the files of a dataset are complete and consistent with each other.",
    )
    validate.add_argument("dataset", type=Path, help="The folder of the dataset.")
    validate.add_argument(
        "--fast",
        action="store_true",
        help="Check only the SHA-256 digest of every file, not whether the contents of the "
        "files are consistent.",
    )

    parts = add_command(
        commands,
        "parts",
        _parts,
        "List the built-in parts or the parts of a configuration, and draw them.",
    )
    parts.add_argument(
        "config",
        type=Path,
        nargs="?",
        help="A configuration whose parts are listed instead of the built-in ones.",
    )
    parts.add_argument("--out", type=Path, help="A PNG file in which the parts are drawn.")
    add_device(parts)


def _preview(options: argparse.Namespace) -> int:
    from ..base.errors import GraycastError
    from ..cell.resolve import open_cell_renderer
    from ..cell.simulate import make_images
    from ..show.report import draw_preview

    cell = load_cell(options)
    if options.image >= len(cell.images):
        raise GraycastError(
            f"--image is {options.image}: a scene of this cell has {len(cell.images)}, from 0 on"
        )
    seed = cell.config.seed if options.seed is None else options.seed
    with open_bars() as bars:
        with open_cell_renderer(cell, device=options.device, progress=bars) as renderer:
            which = _which(cell, options.image)
            bars.line(f"scene {options.scene}{which} by {renderer.name} on {renderer.device}")
            images = make_images(
                cell,
                options.scene,
                seed=seed,
                renderer=renderer,
                progress=bars,
                only=options.image,
            )
            shot = next(images)
    scanner = dict(cell.scanners)[cell.images[options.image][0]]
    draw_preview(shot, scanner.light_code(), options.out)
    _tell_coarse(shot)
    print_shares(shot.sample.manifest["part_reasons"], shot.sample.manifest["reasons"])
    print(options.out)
    return 0


def _which(cell, number: int) -> str:
    """Which of a scene's images is shown, where there are several."""
    if len(cell.images) == 1:
        return ""
    sensor, image = cell.images[number]
    scanner = f" of scanner {sensor}" if sensor else ""
    return f", image {image}{scanner} ({number + 1} of {len(cell.images)})"


def _tell_coarse(shot) -> None:
    """Print which of the dropped parts have coarse collision hulls."""
    from ..world.drop import hull_notes, prepare

    sample = shot.sample
    parts = [sample.scene.parts[kind] for kind in sorted({*sample.layout.part_index})]
    for note in hull_notes(parts, prepare(parts)):
        print(f"note: {note}")


def _validate(options: argparse.Namespace) -> int:
    from ..dataset import validate
    from ..dataset.real import absent

    problems = validate(options.dataset, fast=options.fast)
    for problem in problems:
        print(problem)
    sound = "every file has the digest with which it was written" if options.fast else "valid"
    print(f"{options.dataset}: {f'{len(problems)} problem(s)' if problems else sound}")
    if not problems:
        for lacking in absent(options.dataset):
            print(f"  not known: {lacking}")
    return 1 if problems else 0


def _parts(options: argparse.Namespace) -> int:
    from ..show.report import describe_parts, draw_parts
    from ..world.parts import BUILTIN, builtin_part

    if options.config is None:
        parts = tuple(builtin_part(name) for name in BUILTIN)
        print(describe_parts(parts))
    else:
        parts = load_cell(options).scene.parts
        print(describe_parts(parts))
        _describe_hulls(parts)
    if options.out is not None:
        from ..rendering import open_renderer

        with open_renderer(device=options.device) as renderer:
            draw_parts(parts, options.out, renderer=renderer)
        print(options.out)
    return 0


def _describe_hulls(parts) -> None:
    """Describe the collision hulls of the parts; hulls that are not in the cache are made now."""
    from ..world.drop import hull_notes, prepare
    from ..world.parts import Symmetry
    from ..world.parts.symmetry import shape_symmetry

    with open_stages() as progress:
        prepared = prepare(parts, progress=progress)
    print(
        "the number of collision hulls of each part, and their largest distance from its surface:"
    )
    for part, hulls in zip(parts, prepared, strict=True):
        worst, bound = (f"{1e3 * hulls.error.worst_m:.2f} mm", f"{1e3 * hulls.tolerance_m:.2f} mm")
        print(f"  {part.name}: {len(hulls.hulls)}, {worst} (the bound is {bound})")
    for note in hull_notes(parts, prepared):
        print(f"note: {note}")
    for part in parts:
        if part.symmetry == Symmetry() and shape_symmetry(part.mesh) != Symmetry():
            print(
                f"note: {part.name} states no symmetry, and its shape looks the same after some "
                "turns: if neither print nor colour tells its sides apart, add "
                "`symmetry: {auto: true}`"
            )
