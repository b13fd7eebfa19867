"""The command twin, which fits a simulated scanner to a real one."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import (
    above_zero,
    add_command,
    add_device,
    add_seed,
    positive,
    resolve_cell_option,
    size,
)
from .bars import open_bars


def add_commands(commands: argparse._SubParsersAction) -> None:
    twin = add_command(
        commands,
        "twin",
        _twin,
        "Fit a simulated scanner to scans of a real one, so that the simulated scans have the "
        "same statistics.",
    )
    twin.add_argument(
        "scans",
        nargs="+",
        type=Path,
        help="Three or more real depth maps of the cell: NPY, PNG, TIFF or PLY files, folders of "
        "such files, or datasets of real scans.",
    )
    twin.add_argument(
        "--config",
        type=Path,
        required=True,
        help="The configuration of the cell. It states the bin, its pose, and a rig with the "
        "geometry of the scanner. Its parts are those of the scenes that are generated later; "
        "the search needs none, because it simulates the scenes of the scans.",
    )
    twin.add_argument(
        "--out",
        type=Path,
        required=True,
        help="The new configuration file to write. It must be in the same folder as "
        "--config. The rig file, a report and a picture are written next to it.",
    )
    twin.add_argument(
        "--intrinsics",
        metavar="K",
        help="The camera's intrinsics in pixels: the four numbers fx,fy,cx,cy, or a file "
        "that holds the camera matrix K (default: the rig's).",
    )
    twin.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="The length of one unit of depth in metres, such as 0.001 for millimetres. "
        "Files of integers need it. Files of floating-point numbers are taken to be in "
        "metres without it.",
    )
    twin.add_argument(
        "--size",
        type=size,
        metavar="WxH",
        help="The width and height of the depth map in pixels, such as 1032x772. It is "
        "needed for PLY point clouds that do not state it.",
    )
    twin.add_argument(
        "--rgb",
        type=Path,
        nargs="+",
        default=[],
        help="The colour pictures, one for each depth map in the same order, which show the same "
        "view. They tell how much light the parts reflect. Without them, all parts are grey.",
    )
    twin.add_argument(
        "--kept-aside",
        type=positive,
        default=0,
        metavar="N",
        help="The number of scans, from the last one backwards, that are not fitted. The twin is "
        "compared with them in the end (default: 0).",
    )
    twin.add_argument(
        "--trials",
        type=positive,
        default=500,
        metavar="N",
        help="The number of simulated scanners that the search tries (default: 500).",
    )
    add_seed(twin, 0)
    add_device(twin)


def _twin(options: argparse.Namespace) -> int:
    from ..cell.config import load_config
    from ..cell.resolve import refuse_several
    from ..real.depth_file import read_intrinsics
    from ..real.fitted_config import refuse_existing, refuse_there
    from ..real.picture_pairs import read_rgb
    from ..real.realism import read_scans
    from ..real.twin import check_scans, files_of, make_twin, summary, write_twin

    refuse_existing(options.out, options.config)
    refuse_there(*files_of(options.out))
    cell = resolve_cell_option(load_config(options.config), options)
    refuse_several(cell, "graycast twin")
    intrinsics = None if options.intrinsics is None else read_intrinsics(options.intrinsics)
    K = cell.scanner.rig.camera.K if intrinsics is None else intrinsics
    scans = list(read_scans(options.scans, K=K, scale_m=options.scale, size_px=options.size))
    if not scans:
        raise GraycastError("no scans are given: name depth files or a folder of them")
    check_scans(scans, cell, kept=options.kept_aside)
    pictures = [read_rgb(path) for path in options.rgb]
    if not pictures:
        print("note: no colour pictures are given (--rgb), so all parts are taken to be grey")
    with open_bars() as bars:
        twin = make_twin(
            scans,
            cell,
            pictures=pictures,
            kept=options.kept_aside,
            trials=options.trials,
            seed=options.seed,
            device=options.device,
            progress=bars,
        )
    print("\n".join(summary(twin)))
    for path in write_twin(twin, cell, options.config, options.out):
        print(path)
    return 0
