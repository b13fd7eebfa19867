"""Commands that measure: decode, certify and realism."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..base.errors import GraycastError
from ..base.folder import refuse_foreign, whole_folder
from .arguments import (
    add_backend,
    add_command,
    add_device,
    add_resolution,
    add_rig,
    add_scanner_files,
    add_seed,
    intrinsics_of,
    positive,
    resolve_rig_option,
)
from .bars import open_bars, open_stages

TABLE = "table.txt"  # The command `graycast realism` writes this file to every folder.


def add_commands(commands) -> None:
    _add_decode(commands)
    _add_certify(commands)
    _add_realism(commands)


def _add_decode(commands) -> None:
    decode = add_command(
        commands,
        "decode",
        _decode,
        "Decode a scanner's pictures to projector coordinates and, if its rig is known, to depth.",
    )
    decode.add_argument(
        "stack",
        type=Path,
        help="The stack file, which describes each picture, or a folder that holds a file "
        "stack.yaml.",
    )
    decode.add_argument(
        "--rig",
        help="A rig file or the name of a preset. With a rig, depth and a point cloud are "
        "also written (default: the rig that the stack file names, if any).",
    )
    add_resolution(decode)
    decode.add_argument(
        "--average",
        action="store_true",
        help="Write one 3D point for each projector pixel instead of each camera pixel.",
    )
    decode.add_argument(
        "--out", type=Path, required=True, help="The folder to which the results are written."
    )


def _add_certify(commands) -> None:
    certify = add_command(
        commands,
        "certify",
        _certify,
        "Measure the accuracy of a virtual scanner on virtual artefacts: planes, spheres and "
        "ball bars.",
    )
    add_rig(certify)
    certify.add_argument(
        "--out", type=Path, required=True, help="The folder to which the results are written."
    )
    add_seed(certify, default=0)
    add_backend(certify, default="mitsuba")
    add_device(certify)


def _add_realism(commands) -> None:
    realism = add_command(
        commands,
        "realism",
        _realism,
        "Measure the statistics of real or simulated depth maps, and compare two sets of them.",
    )
    realism.add_argument(
        "depth",
        type=Path,
        nargs="*",
        help="The depth maps: NPY, PNG, TIFF or PLY files, folders of such files, or datasets of "
        "Graycast.",
    )
    add_scanner_files(realism)
    realism.add_argument(
        "--gray",
        type=Path,
        nargs="+",
        default=(),
        help="The grey pictures that belong to the depth maps, one for each map.",
    )
    realism.add_argument(
        "--reason",
        type=Path,
        nargs="+",
        default=(),
        help="The maps of reasons that belong to the depth maps, one for each map.",
    )
    realism.add_argument(
        "--out",
        type=Path,
        help="The folder to which the table, the figures as JSON and the plots are written.",
    )
    realism.add_argument(
        "--compare",
        type=Path,
        nargs=2,
        metavar=("A", "B"),
        help="Two sets to compare: folders that this command wrote, datasets, or folders of depth "
        "maps, for which --intrinsics, --scale and --size are used.",
    )
    realism.add_argument(
        "--classifier",
        action="store_true",
        help="Train a classifier to distinguish the two sets of --compare, and report its "
        "accuracy and the features that it uses. It needs scikit-learn.",
    )
    realism.add_argument(
        "--most",
        type=positive,
        default=20,
        metavar="N",
        help="The number of depth maps of each set that --classifier uses, evenly spaced in "
        "the set (default: 20).",
    )
    add_seed(realism, default=0)


def _decode(options: argparse.Namespace) -> int:
    from ..camera.rig_file import load_scanner
    from ..camera.stack import CODE, decode_stack, describe_result, read_description, write_result

    refuse_foreign(options.out, CODE)
    stack = options.stack / "stack.yaml" if options.stack.is_dir() else options.stack
    if options.rig is not None:
        scanner = resolve_rig_option(options)
    else:
        own = read_description(stack).rig
        scanner = None if own is None else load_scanner(stack.parent / own)
    if scanner is None:
        result = decode_stack(stack, average=options.average)
    else:
        result = decode_stack(stack, scanner.rig, average=options.average, filters=scanner.filters)
    written = write_result(result, options.out)
    print(describe_result(result))
    for path in written:
        print(path)
    return 0


def _certify(options: argparse.Namespace) -> int:
    from ..rendering import open_renderer
    from ..score.metrology import CERTIFICATE, certify, describe, write_certificate

    scanner = resolve_rig_option(options)
    refuse_foreign(options.out, CERTIFICATE)
    with (
        whole_folder(options.out) as folder,
        open_renderer(options.backend, device=options.device) as renderer,
        open_bars() as bars,
    ):
        certificate = certify(scanner, renderer=renderer, seed=options.seed, progress=bars)
        page = write_certificate(certificate, folder)
    print(describe(certificate))
    print(options.out / page.name)
    return 0


def _realism(options: argparse.Namespace) -> int:
    from ..camera.decode import Reason
    from ..real.realism import RECORD_FILE, measure_all, pool, read_scans, table, write_record

    if (options.compare is None) == (not options.depth):
        raise GraycastError(
            "no depth maps are given: give depth maps to measure, or --compare with two sets"
        )
    if options.classifier and options.compare is None:
        raise GraycastError("--classifier distinguishes two sets: add --compare with two sets")
    if options.compare is not None:
        if options.gray or options.reason:
            raise GraycastError(
                "--gray and --reason are not used by --compare: measure each set with them and "
                "--out, and compare the folders"
            )
        if options.out is not None and (options.out / RECORD_FILE).exists():
            raise GraycastError(
                f"{options.out}: is itself one of the measured sets: give another folder with --out"
            )
        return _compare(options)
    if options.out is None:
        raise GraycastError("--out is missing: give the folder to which the measurement is written")
    refuse_foreign(options.out, TABLE)
    K = intrinsics_of(options)
    with whole_folder(options.out) as folder:
        scans = read_scans(
            options.depth,
            K=K,
            gray=_files(options.gray),
            reason=_files(options.reason),
            reason_names={reason.value: reason.name for reason in Reason},
            scale_m=options.scale,
            size_px=options.size,
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
    """The scans themselves; notes about their depth are added to the list."""
    from ..real.depth_sense import filled_holes

    for scan in scans:
        if note := filled_holes(scan.depth_m, scan.name):
            notes.append(note)
        yield scan


def _compare(options: argparse.Namespace) -> int:
    """Print two sets side by side and, with `--classifier`, the classifier's result."""
    from ..real.realism import table, two_sample_table, write_two_sample

    if options.out is not None:
        refuse_foreign(options.out, TABLE)
    found = _two_sample(options) if options.classifier else None
    records = [_record(path, options) for path in options.compare]
    print(table(*records))
    if found is not None:
        print("\n" + two_sample_table(found[0]))
    if options.out is not None:
        with whole_folder(options.out) as folder:
            _write_table(records, folder)
            if found is not None:
                test, first, second = found
                write_two_sample(test, first, second, folder)
        print(options.out)
    return 0


def _two_sample(options: argparse.Namespace) -> tuple:
    """Run the classifier test; return its result and both sets of maps."""
    from ..real.realism import read_perfect, two_sample_test

    first, second = (_spread(list(_scans(path, options)), options.most) for path in options.compare)
    perfect = _spread(list(read_perfect(options.compare[1])), options.most)
    a, b = options.compare
    names = (a.name, b.name) if a.name != b.name else (str(a), str(b))
    with open_stages() as progress:
        test = two_sample_test(
            first, second, perfect=perfect, names=names, seed=options.seed, progress=progress
        )
    return test, first, second


def _spread(scans: list, most: int) -> list:
    """At most `most` items, evenly spaced over the set."""
    if len(scans) <= most:
        return scans
    return [scans[k * len(scans) // most] for k in range(most)]


def _write_table(records: list, folder: Path) -> None:
    from ..real.realism import draw_realism, table

    (folder / TABLE).write_text(table(*records) + "\n", encoding="utf-8")
    draw_realism(records, folder / "plots.png")


def _record(path: Path, options: argparse.Namespace):
    """Read a measured set, or measure a dataset or a folder of depth maps."""
    from ..real.realism import RECORD_FILE, measure_all, pool, read_record

    if path.is_file() or (path / RECORD_FILE).is_file():
        return read_record(path)
    return pool(measure_all(_scans(path, options)), name=str(path))


def _scans(path: Path, options: argparse.Namespace) -> Iterator:
    """The depth maps of one set of `--compare`."""
    from ..real.realism import read_scans

    return read_scans([path], K=intrinsics_of(options), scale_m=options.scale, size_px=options.size)


def _files(paths: Sequence[Path]) -> list[Path]:
    """The given files, and the files in the given folders sorted by name."""
    files = []
    for path in paths:
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        if not inside:
            raise GraycastError(f"{path}: is an empty folder: give a folder with pictures")
        files += inside
    return files
