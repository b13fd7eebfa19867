"""The command that fits a configuration to a real cell: fit-bin."""

import argparse
import math
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import (
    above_zero,
    add_command,
    add_device,
    add_scanner_files,
    add_seed,
    distortion_of,
    intrinsics_of,
)


def add_commands(commands) -> None:
    fit = add_command(
        commands,
        "fit-bin",
        _fit_bin,
        "Estimate the pose and the colours of a real bin from views of the bin, empty or filled.",
    )
    fit.add_argument(
        "real",
        nargs="+",
        type=Path,
        help="The views of one camera: depth files or point clouds (PNG, TIFF, NPY, PLY), "
        "folders with the subfolders rgb and depth, or scene folders of a dataset.",
    )
    fit.add_argument(
        "--config",
        type=Path,
        required=True,
        help="The configuration of the cell, with its bin, rig and light.",
    )
    fit.add_argument(
        "--out",
        type=Path,
        required=True,
        help="The new configuration file to write. It must be in the same folder as --config.",
    )
    _add_files(fit)
    fit.add_argument(
        "--inner",
        metavar="L,W,H",
        help="The inner sizes of the bin along x, y and z in metres (default: as configured).",
    )
    fit.add_argument(
        "--wall",
        type=above_zero,
        metavar="METRES",
        help="The thickness of the bin's walls in metres (default: as configured).",
    )
    _add_fitting(fit)


def _add_fitting(fit: argparse.ArgumentParser) -> None:
    """What is known of the bin and its light, and how much is fitted."""
    fit.add_argument(
        "--azimuth",
        type=float,
        metavar="DEGREES",
        help="The approximate direction of the camera's x axis in the bin, in degrees. A box "
        "has the same shape after half a turn, and this option chooses between the two "
        "poses (default: as configured).",
    )
    fit.add_argument(
        "--floor-reflectance",
        type=above_zero,
        metavar="SHARE",
        help="The mean linear reflectance of the floor, from 0 to 1, to which all colours "
        "are scaled (default: as configured).",
    )
    fit.add_argument(
        "--white",
        type=Path,
        help="A linear picture of the bin while the projector shows white. With --black, it "
        "determines the brightness of the lamps.",
    )
    fit.add_argument(
        "--black",
        type=Path,
        help="A linear picture of the bin while the projector shows black, taken with the "
        "exposure of --white.",
    )
    fit.add_argument(
        "--cluttered",
        action="store_true",
        help="State that the bin is not empty in the views. Each pixel then takes the "
        "farthest depth on which two views agree. Give three or more views with "
        "different poses of the parts. If the configuration states an approximate "
        "view.T_world_cam, the search starts there.",
    )
    fit.add_argument(
        "--pose-only",
        action="store_true",
        help="Estimate only the pose, and keep the configured colours and light.",
    )
    fit.add_argument(
        "--bend",
        type=Path,
        metavar="BIN.ply",
        help="Bend the mesh of the bin to where the views measured its surface, write it to this "
        "new PLY file in the folder of --out, and name it in the new configuration.",
    )
    add_seed(fit, 0)
    add_device(fit)


def _add_files(fit: argparse.ArgumentParser) -> None:
    fit.add_argument(
        "--rgb",
        type=Path,
        nargs="+",
        default=[],
        help="The colour pictures, one for each depth file in the same order.",
    )
    add_scanner_files(fit, intrinsics=" (default: the rig's)", distortion="")


def _fit_bin(options: argparse.Namespace) -> int:
    from ..cell.config import load_config
    from ..cell.resolve import refuse_several, resolve_cell
    from ..real.fit_bin import (
        FileOptions,
        azimuth_of,
        empty_view,
        fit_pose,
        read_frames,
        read_views,
        refuse_existing,
        shape_of,
        summary,
        with_bend,
        with_look,
        write_fit,
    )
    from ..world.scene import bin_of

    refuse_existing(options.out, options.config)
    if options.bend is not None:
        if options.bend.suffix.lower() != ".ply":
            raise GraycastError(f"--bend {options.bend}: give a name that ends with .ply")
        refuse_existing(options.bend, options.config)
    if (options.white is None) != (options.black is None):
        raise GraycastError("--white and --black are used only together: give both or neither")
    if options.pose_only and (options.white or options.floor_reflectance):
        raise GraycastError(
            "--pose-only does not estimate colours and light: remove --rgb, --floor-reflectance, "
            "--white and --black"
        )
    config = load_config(options.config)
    size = {} if options.inner is None else {"inner_m": _inner(options.inner)}
    size |= {} if options.wall is None else {"wall_m": options.wall}
    if size and config.bin.mesh is not None:
        raise GraycastError(
            f"--inner and --wall apply only to a box, and the bin of {options.config} is the mesh "
            f"{config.bin.mesh}: remove them"
        )
    known = options.wall or ("wall_m" in config.bin.model_fields_set and options.inner is None)
    config = config.model_copy(update={"bin": config.bin.model_copy(update=size)})
    cell = resolve_cell(config, options.config.parent)
    refuse_several(cell, "graycast fit-bin")
    files = FileOptions(
        K=intrinsics_of(options),
        distortion=distortion_of(options),
        scale_m=options.scale,
        size_px=options.size,
    )
    views = read_views(options.real, rgb=options.rgb, options=files, own=cell.scene.rig.camera)
    if options.cluttered:
        views = (empty_view(views),)
    shape = shape_of(bin_of(cell.scene), wall_known=bool(known))
    azimuth = azimuth_of(config) if options.azimuth is None else math.radians(options.azimuth)
    known_pose = options.cluttered and config.view.T_world_cam is not None
    stated = cell.scene.T_world_cam if known_pose else None
    fit = fit_pose(views, shape, azimuth_rad=azimuth, seed=options.seed, stated=stated)
    paired = options.white is not None
    needs_look = paired or options.floor_reflectance is not None
    if not options.pose_only and (needs_look or any(view.rgb is not None for view in views)):
        fit = with_look(
            fit,
            cell,
            views,
            floor_reflectance=options.floor_reflectance,
            frames=read_frames(options.white, options.black, views[0]) if paired else None,
            device=options.device,
            seed=options.seed,
        )
    if options.bend is not None:
        fit = with_bend(fit, cell, views)
    print("\n".join(summary(fit)))
    for path in write_fit(fit, cell, views, options.config, options.out, mesh=options.bend):
        print(path)
    return 0


def _inner(text: str) -> tuple[float, float, float]:
    length, width, height = _numbers(text, 3)
    if not min(length, width, height) > 0:
        raise GraycastError(f"--inner {text}: give three sizes in metres, each greater than 0")
    return length, width, height


def _numbers(text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise GraycastError(f"{text!r} is not a list of {count} numbers separated by commas")
    return numbers
