"""Commands for real scans: real measure, compare, twin, fit-bin; material is in its own module."""

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from ..base.errors import GraycastError
from ..base.folder import refuse_foreign, whole_folder
from .arguments import (
    add_command,
    add_device,
    add_group,
    add_option,
    add_out,
    add_shared,
    file_options,
    resolve_config,
)
from .bars import open_bars, open_stages
from .material_command import add_material
from .readers import above_zero, metres, numbers, positive, reader

# Heavy modules are imported by the command that needs them, so that --help answers at once.

TABLE = "table.txt"  # measure and compare write this file to every folder.
FILES = "NPY, PNG, TIFF or PLY files, folders of such files, or datasets"
NEW_FILE = "The YAML file to write, which must be new and in the folder of --config."
TWIN = """\
The simulated scans then have the same statistics. The configuration states the bin, its pose, and a
rig with the geometry of the scanner. Its parts are those of the scenes that are generated later;
the search needs none, because it simulates the scenes of the scans. The rig file, a report and a
picture are written next to the new configuration. Colour pictures tell how much light the parts
reflect; without them, all parts are grey."""


def add_commands(commands) -> None:
    group = add_group(
        commands, "real", "Measure and compare real scans, and fit a simulation to them."
    )
    measure = add_command(
        group, "measure", _measure, "Measure the statistics of real or simulated depth maps.",
        example="scans --intrinsics K.json --out out/real",
    )  # fmt: skip
    add_option(measure, "depth", Path, f"The depth maps: {FILES}.", nargs="+")
    add_out(measure, "The folder to write.")
    add_shared(measure, "--intrinsics", "--scale", "--size", "--ray-length")
    gray = "The grey pictures that belong to the depth maps, one for each map."
    add_option(measure, "--gray", Path, gray, nargs="+")
    reason = "The maps of reasons that belong to the depth maps, one for each map."
    add_option(measure, "--reason", Path, reason, nargs="+")

    compare = add_command(
        group, "compare", _compare, "Compare the statistics of two sets of depth maps.",
        example="out/real out/simulated --out out/compared",
    )  # fmt: skip
    sets = f"a folder that graycast real measure wrote, or depth maps: {FILES}"
    add_option(compare, "first", Path, f"The first set: {sets}.")
    add_option(compare, "second", Path, "The second set, of the same kinds.")
    add_out(compare, "The folder to write.", required=False)
    add_shared(compare, "--intrinsics", "--scale", "--size", "--ray-length")
    add_option(
        compare,
        "--classifier",
        None,
        "Train a classifier to distinguish the two sets, and report how well it can (AUC). It "
        "needs scikit-learn.",
    )
    most = "The number of depth maps of each set that --classifier uses, evenly spaced in the set."
    add_option(compare, "--max-maps", positive, most, 20)
    add_shared(compare, "--seed", default=0)

    twin = add_command(
        group, "twin", _twin, "Fit a simulated scanner to scans of a real one.",
        example="scans --config cell.yaml --out twin.yaml", more=TWIN,
    )  # fmt: skip
    scans = f"Three or more real depth maps of the cell: {FILES} of real scans."
    add_option(twin, "scans", Path, scans, nargs="+")
    add_shared(twin, "--config", required=True)
    add_out(twin, NEW_FILE)
    add_shared(twin, "--intrinsics", usual="those of the rig")
    add_shared(twin, "--scale", "--size", "--ray-length")
    add_shared(twin, "--rgb", nargs="+")
    add_option(
        twin,
        "--kept-aside",
        positive,
        "The number of scans, from the last one backwards, that are not fitted. The twin is "
        "compared with them in the end.",
        0,
    )
    trials = "The number of simulated scanners that the search tries."
    add_option(twin, "--trials", positive, trials, 500)
    add_shared(twin, "--seed", default=0)
    add_device(twin)
    _add_fit_bin(group)
    add_material(group)


def _add_fit_bin(group) -> None:
    fit = add_command(
        group, "fit-bin", _fit_bin, "Estimate the pose and the colours of a real bin from views.",
        example="views --config cell.yaml --out fitted.yaml", more="The bin is empty or filled.",
    )  # fmt: skip
    add_option(
        fit,
        "views",
        Path,
        "The views of one camera: depth files or point clouds (PNG, TIFF, NPY, PLY), folders with "
        "the subfolders rgb and depth, or scene folders of a dataset.",
        nargs="+",
    )
    add_shared(fit, "--config", required=True)
    add_out(fit, NEW_FILE)
    add_shared(fit, "--rgb", nargs="+")
    add_shared(fit, "--intrinsics", "--distortion", usual="those of the rig")
    add_shared(fit, "--scale", "--size", "--ray-length")
    inner = "The inner sizes of the bin along x, y and z in metres."
    add_option(fit, "--inner", _inner, inner, usual="as configured", metavar="L,W,H")
    wall = "The thickness of the bin's walls in metres."
    add_option(
        fit, "--wall", metres(above_zero, 1.0), wall, usual="as configured", metavar="METRES"
    )
    add_option(
        fit,
        "--azimuth",
        float,
        "The approximate direction of the camera's x axis in the bin, in degrees. A box has the "
        "same shape after half a turn, and this option chooses between the two poses.",
        usual="as configured",
        metavar="DEGREES",
    )
    add_option(
        fit,
        "--floor-reflectance",
        above_zero,
        "The mean linear reflectance of the floor, from 0 to 1, to which all colours are scaled.",
        usual="as configured",
        metavar="SHARE",
    )
    picture = "A linear picture of the bin while the projector shows"
    lamps = "With --black, it determines the brightness of the lamps."
    add_option(fit, "--white", Path, f"{picture} white. {lamps}")
    add_option(fit, "--black", Path, f"{picture} black, taken with the exposure of --white.")
    add_option(
        fit,
        "--cluttered",
        None,
        "State that the bin is not empty in the views. Each pixel then takes the farthest depth on "
        "which two views agree. Give three or more views with different poses of the parts. If the "
        "configuration states an approximate view.T_world_cam, the search starts there.",
    )
    pose = "Estimate only the pose, and keep the configured colours and light."
    add_option(fit, "--pose-only", None, pose)
    add_option(
        fit,
        "--bend",
        Path,
        "Bend the mesh of the bin to where the views measured its surface, write it to this new "
        "PLY file in the folder of --out, and name it in the new configuration.",
        metavar="BIN.ply",
    )
    add_shared(fit, "--seed", default=0)
    add_device(fit)


def _measure(options: argparse.Namespace) -> int:
    from ..camera.decode import Reason
    from ..real.realism import RECORD_FILE, measure_all, pool, read_scans, table, write_record

    refuse_foreign(options.out, TABLE)
    files = file_options(options)
    with whole_folder(options.out) as folder:
        scans = read_scans(
            options.depth,
            options=files,
            gray=options.gray or (),
            reason=options.reason or (),
            reason_names={reason.value: reason.name for reason in Reason},
        )
        name = options.out.name or str(options.out)
        notes: list[str] = []
        record = pool(measure_all(_noted(scans, notes)), name=name)
        _write_table([record], folder)
        write_record(record, folder / RECORD_FILE)
    print(table(record))
    for note in notes:
        print(f"note: {note}")
    print(options.out)
    return 0


def _noted(scans, notes: list[str]):
    """Yield the scans, and add notes about their depth to the list."""
    from ..real.depth_sense import filled_holes

    for scan in scans:
        if note := filled_holes(scan.depth_m, scan.name):
            notes.append(note)
        yield scan


def _compare(options: argparse.Namespace) -> int:
    """Print the statistics of two sets and, with `--classifier`, the classifier's result."""
    from ..real.realism import RECORD_FILE, table, two_sample_table, write_two_sample

    if options.out is not None:
        if (options.out / RECORD_FILE).exists():
            raise GraycastError(
                f"{options.out}: is itself one of the measured sets: give another folder with --out"
            )
        refuse_foreign(options.out, TABLE)
    two_sample = _two_sample(options) if options.classifier else None
    records = [_record(path, options) for path in (options.first, options.second)]
    print(table(*records))
    if two_sample is not None:
        print("\n" + two_sample_table(two_sample[0]))
    if options.out is not None:
        with whole_folder(options.out) as folder:
            _write_table(records, folder)
            if two_sample is not None:
                test, first, second = two_sample
                write_two_sample(test, first, second, folder)
        print(options.out)
    return 0


def _two_sample(options: argparse.Namespace) -> tuple:
    """Return the result of the classifier test, and the maps of both sets."""
    from ..real.realism import two_sample_test

    a, b, most = options.first, options.second, options.max_maps
    first, second = (_spread(list(_scans(path, options)), most) for path in (a, b))
    names = (a.name, b.name) if a.name != b.name else (str(a), str(b))
    with open_stages() as progress:
        test = two_sample_test(first, second, names=names, seed=options.seed, progress=progress)
    return test, first, second


def _spread(scans: list, most: int) -> list:
    """Return at most `most` items, evenly spaced over the set."""
    count = min(most, len(scans))
    return [scans[k * len(scans) // count] for k in range(count)]


def _write_table(records: list, folder: Path) -> None:
    from ..real.realism import draw_realism, table

    (folder / TABLE).write_text(table(*records) + "\n", encoding="utf-8")
    draw_realism(records, folder / "plots.png")


def _record(path: Path, options: argparse.Namespace):
    """Return the record of a measured set, or measure a dataset or a folder of depth maps."""
    from ..real.realism import RECORD_FILE, measure_all, pool, read_record

    if path.is_file() or (path / RECORD_FILE).is_file():
        return read_record(path)
    return pool(measure_all(_scans(path, options)), name=str(path))


def _scans(path: Path, options: argparse.Namespace) -> Iterator:
    """Return the depth maps in a path."""
    from ..real.realism import read_scans

    return read_scans([path], options=file_options(options))


def _twin(options: argparse.Namespace) -> int:
    from ..cell.config import load_config
    from ..cell.resolve import require_one_still_image
    from ..real.fitted_config import refuse_existing, refuse_there
    from ..real.picture_pairs import read_rgb
    from ..real.realism import read_scans
    from ..real.twin import check_scans, files_of, make_twin, summary, write_twin

    refuse_existing(options.out, options.config)
    refuse_there(*files_of(options.out))
    cell = resolve_config(load_config(options.config), options.config, options.config.parent)
    require_one_still_image(cell, "graycast real twin")
    files = file_options(options)
    if files.K is None:
        files = replace(files, K=cell.scanner.rig.camera.K)
    scans = list(read_scans(options.scans, options=files))
    if not scans:
        raise GraycastError("no scans are given: name depth files or a folder of them")
    check_scans(scans, cell, aside=options.kept_aside)
    pictures = [read_rgb(path) for path in options.rgb or ()]
    if not pictures:
        print("note: no colour pictures are given (--rgb), so all parts are taken to be grey")
    with open_bars() as bars:
        twin = make_twin(
            scans,
            cell,
            pictures=pictures,
            aside=options.kept_aside,
            trials=options.trials,
            seed=options.seed,
            device=options.device,
            progress=bars,
        )
    print("\n".join(summary(twin)))
    for path in write_twin(twin, cell, options.config, options.out):
        print(path)
    return 0


def _fit_bin(options: argparse.Namespace) -> int:
    from ..cell.config import load_config
    from ..cell.resolve import require_one_still_image, resolve_cell
    from ..real.fit_bin import (
        azimuth_of,
        empty_view,
        fit_pose,
        read_frames,
        read_views,
        shape_of,
        summary,
        with_bend,
        with_look,
        write_fit,
    )
    from ..real.fitted_config import refuse_existing
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
    size = {} if options.inner is None else {"inner_m": options.inner}
    size |= {} if options.wall is None else {"wall_m": options.wall}
    if size and config.bin.mesh is not None:
        raise GraycastError(
            f"--inner and --wall apply only to a box, and the bin of {options.config} is the mesh "
            f"{config.bin.mesh}: remove them"
        )
    known = options.wall or ("wall_m" in config.bin.model_fields_set and options.inner is None)
    config = config.model_copy(update={"bin": config.bin.model_copy(update=size)})
    cell = resolve_cell(config, options.config.parent)
    require_one_still_image(cell, "graycast real fit-bin")
    views = read_views(
        options.views,
        rgb=options.rgb or [],
        options=file_options(options),
        own=cell.scene.rig.camera,
    )
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


_inner = metres(
    reader(
        numbers,
        lambda sizes_m: len(sizes_m) == 3 and min(sizes_m) > 0,
        "three sizes in metres, each greater than 0, such as 0.6,0.4,0.2",
    ),
    50.0,
)
