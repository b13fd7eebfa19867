"""The command parts, which lists the built-in parts or those of a configuration."""

import argparse
from pathlib import Path

from .arguments import add_command, add_device, add_option, add_png, cell_of
from .bars import open_stages

# Heavy modules are imported by the command, so that --help answers at once.


def add_parts(commands) -> None:
    """Add the command `parts`."""
    parts = add_command(
        commands, "parts", _parts, "List the built-in parts or the parts of a configuration.",
        example="--out parts.png", more="With --out, the command also draws them.",
    )  # fmt: skip
    own = "A configuration whose parts are listed instead of the built-in ones."
    add_option(parts, "config", Path, own, nargs="?")
    add_png(parts)
    add_device(parts)


def _parts(options: argparse.Namespace) -> int:
    from ..cell.framing import framing_line
    from ..show.report import describe_parts, draw_parts
    from ..world.parts import BUILTIN, builtin_part

    if options.config is None:
        parts = tuple(builtin_part(name) for name in BUILTIN)
        print(describe_parts(parts))
    else:
        scene = cell_of(options).scene
        parts = scene.parts
        print(describe_parts(parts))
        print(f"with {scene.rig.name}, {framing_line(scene)}")
        _describe_hulls(parts)
    if options.out is not None:
        from ..rendering import open_renderer

        with open_renderer(device=options.device) as renderer:
            draw_parts(parts, options.out, renderer=renderer)
        print(options.out)
    return 0


def _describe_hulls(parts) -> None:
    """Print facts about the parts' collision hulls; hulls that are not cached are computed now."""
    from ..world.drop import hull_notes, prepare
    from ..world.parts import Symmetry
    from ..world.parts.symmetry import shape_symmetry

    with open_stages() as progress:
        prepared = prepare(parts, progress=progress)
    print(
        "the number of collision hulls of each part, and their largest distance from its surface:"
    )
    for part, hulls in zip(parts, prepared, strict=True):
        worst, bound = (f"{1e3 * hulls.worst_m:.2f} mm", f"{1e3 * hulls.tolerance_m:.2f} mm")
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
