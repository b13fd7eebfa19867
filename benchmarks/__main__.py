"""Command line of the benchmarks, which also write tables of docs/: `python -m benchmarks --help`.

The module of a benchmark is imported only when it runs, because most import all of Graycast.
"""

import argparse
import importlib
import json
import os
import platform
import re
import signal
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from .compare import CompareError, commit_of, compare, git, summarise, table
from .figures import describe
from .processes import peak_rss_bytes
from .stages import STAGES

ROOT = Path(__file__).resolve().parents[1]
Option = tuple[tuple[str, ...], dict[str, Any]]
COMPARE = """\
Time the stages of the working tree, as it is, against those of another commit, and print a table.

Both run in turn with the same Python, one process each per round. "here" is the working tree,
"there" the other commit; the figures are medians over rounds, in seconds of processor time unless
the row names something else. A ratio is here / there within one round: the table has the median,
the lowest and the highest, and marks a median above 1.05. A mark whose lowest ratio is below 1 may
be noise: time that stage alone, which gives it more rounds.

    python -m benchmarks compare main
    python -m benchmarks compare HEAD~5 --stages drop,render --minutes 4
    python -m benchmarks compare 114e8a0 --path /tmp/packages --json ratios.json
"""
SIGMA = """\
Print the error of depth in its own sigmas (the 68 % quantile) for four codes and 1 to 64 light
paths a pixel: first as the code alone states sigma, then with the renderer's share, and the share
of pixels that are off by more than five sigmas, if there are any. The leaning wall is compared with
its true depth; of the two facing walls, two renderings are compared with each other, except under
plain Gray code. It takes about 3 minutes on two processors."""


def of(*names: str, **words: Any) -> Option:
    return names, words


def number(name: str, default: int, help: str) -> Option:
    return of(name, type=int, default=default, metavar="N", help=f"{help} (default: {default}).")


def file(name: str, help: str, **words: Any) -> Option:
    return of(name, type=Path, metavar="FILE", help=help, **words)


def samples(default: int) -> Option:
    return number("--samples", default, "The largest number of samples per pixel of Cycles")


def out(page: str) -> Option:
    help = f"The file to which the page is written (default: docs/measurements/{page})."
    return file("--out", help, default=ROOT / "docs" / "measurements" / page)


def stages(text: str) -> list[str]:
    names = text.split(",")
    if unknown := set(names) - set(STAGES):
        message = f"no stage {', '.join(sorted(unknown))}: choose from {', '.join(STAGES)}"
        raise argparse.ArgumentTypeError(message)
    return names


JSON = file("--json", "A file to which all figures are written.")
PLOT = file("--plot", "A PNG file in which the figures are plotted.")
RUN_OPTION = of(
    "--detector",
    type=Path,
    metavar="RUN",
    help="The folder that graycast detector train wrote. The instances are then of the scenes "
    "that its training kept for tests, and its masks and its boxes are two more cases.",
)
FOLDER = of("--out", type=Path, metavar="FOLDER", help="A new folder for BOP results and pictures.")
# Each command calls the function `measure` of its module, with its options as arguments, and
# prints the result.
FIGURES: dict[str, tuple[str, list[Option]]] = {
    "agree": (
        "Compare Cycles' pictures with Mitsuba's: docs/measurements/renderers.md.",
        [samples(64), PLOT],
    ),
    "denoise": ("Decode denoised pictures: docs/measurements/renderers.md.", [samples(128), PLOT]),
    "renderers": (
        "Time Cycles and Mitsuba's one pass: docs/measurements/renderers.md.",
        [samples(16), PLOT],
    ),
    "engines": ("Time workers and Ray against a plain loop: docs/how-to/many-scenes.md.", []),
    "zoo": (
        "Drop parts of each family and check their balance: docs/measurements/drop.md.",
        [
            of(
                "--families",
                nargs="+",
                default=argparse.SUPPRESS,
                metavar="NAME",
                help="The families that are dropped (default: all of them).",
            ),
            of(
                "--counts",
                type=int,
                nargs="+",
                default=[1, 10],
                metavar="N",
                help="The numbers of parts in a drop (default: 1 10).",
            ),
            number("--seeds", 20, "The number of drops of each kind"),
        ],
    ),
    "rescan": (
        "Scan datasets of ours again without their scanner depth: docs/how-to/rescan.md.",
        [number("--scenes", 4, "The number of scenes of each cell")],
    ),
    "reenact": (
        "Simulate a real scan on its own surface: docs/measurements/reenactment.md.",
        [
            of("stack", type=Path, help="The stack file of the scan."),
            file("--rig", "The rig file of the scan.", required=True),
            of(
                "--mask",
                type=Path,
                nargs="+",
                required=True,
                dest="masks",
                metavar="PNG",
                help="A mask of each material; all other pixels are one more material.",
            ),
            of(
                "--reflectance",
                type=float,
                metavar="SHARE",
                help="The reflectance of all other pixels, if they show a matt surface.",
            ),
            of("--metal", action="store_true", help="The masks are known to show metal."),
            of(
                "--out",
                type=Path,
                required=True,
                metavar="FOLDER",
                help="A folder for the simulated stack and for a picture of both.",
            ),
            number("--samples", 128, "The number of light paths per pixel"),
        ],
    ),
    "live": (
        "Measure the response times of graycast live: docs/measurements/live.md.",
        [
            of("config", type=Path, help="The YAML file of the configuration."),
            number("--rounds", 20, "The number of times that each kind of change is made"),
        ],
    ),
    "detectors": (
        "Time a training's reading, and detections: docs/measurements/detection.md.",
        [
            of(
                "runs",
                type=Path,
                nargs="+",
                metavar="RUN",
                help="What graycast detector train wrote.",
            ),
            of(
                "--on",
                type=Path,
                required=True,
                dest="dataset",
                metavar="DATASET",
                help="A dataset of at least 28 scenes.",
            ),
        ],
    ),
    "poses": (
        "Measure how well and how fast poses are found: docs/measurements/pose.md.",
        [
            of(
                "datasets",
                type=Path,
                nargs="+",
                metavar="DATASET",
                help="What graycast generate made.",
            ),
            number("--instances", 100, "The number of instances of each dataset"),
            RUN_OPTION,
            FOLDER,
        ],
    ),
}


def parsed(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    commands = parser.add_subparsers(required=True, metavar="NAME")

    def add(name: str, run: Callable[..., int], help: str, options: Sequence[Option], **words: Any):
        subparser = commands.add_parser(name, help=help, **{"description": help} | words)
        subparser.set_defaults(run=run)
        for names, of_one in options:
            subparser.add_argument(*names, **of_one)

    add(
        "compare",
        run_compare,
        "Time all stages against those of another commit.",
        [
            of("rev", metavar="REV", help="The other commit, by its hash, a tag or a branch."),
            of(
                "--minutes",
                type=float,
                default=10,
                metavar="M",
                help="A round is begun if it fits into this time; two always run (default: 10).",
            ),
            of(
                "--stages",
                type=stages,
                default=STAGES,
                metavar="S,...",
                help=f"The stages that are timed, out of {', '.join(STAGES)} (default: all).",
            ),
            of(
                "--path",
                type=Path,
                metavar="DIR",
                help="A folder with packages that only the other commit needs; fill it with "
                "pip install --no-deps --target DIR.",
            ),
            JSON,
        ],
        description=COMPARE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    sections = "Sections that are printed, and no page written: rendering, drops, scene, paper, "
    add(
        "page",
        run_page,
        "Measure all figures of docs/measurements/benchmarks.md: 8 minutes on two processors.",
        [
            of("sections", nargs="*", metavar="SECTION", help=sections + "decoding, hulls."),
            out("benchmarks.md"),
        ],
    )
    resolution = of(
        "--resolution",
        choices=("small", "low", "full"),
        default="low",
        help="The resolution of the scanners (default: low).",
    )
    add(
        "materials",
        run_materials,
        "Measure right and wrong depth for docs/measurements/materials.md, in half an hour.",
        [resolution, out("materials.md")],
    )
    picture = ROOT / "docs" / "images" / "materials.jpg"
    help = "The file to which the picture is written (default: docs/images/materials.jpg)."
    add(
        "swatches",
        run_swatches,
        "Draw all materials by name for the reference, in 5 minutes.",
        [file("--out", help, default=picture)],
    )
    add(
        "caustics",
        run_caustics,
        "Print noise and cost of the light that comes by shiny parts, in 10 minutes; or draw it.",
        [
            file("--picture", "Draw two pictures side by side into this file instead."),
            number("--samples", 4096, "Paths from the camera alone in the left picture"),
        ],
    )
    add(
        "sigma",
        run_sigma,
        "Compare the depth errors of simulated scans with the stated sigma.",
        [],
        description=SIGMA,
    )
    add(
        "shelf",
        run_shelf,
        "Measure the scanners with names for docs/reference/shelf.md, in a quarter of an hour.",
        [
            of("names", nargs="*", metavar="NAME", help="The scanners (default: all of them)."),
            resolution,
            file("--pictures", "A folder for pictures of the volumes; nothing is measured then."),
        ],
    )
    add(
        "decoders",
        run_decoders,
        "Write stacks with true depth, or compare decoders on them: docs/measurements/decoders.md.",
        [
            of("action", choices=("write", "compare"), help="What is done with the folder."),
            of("folder", type=Path, metavar="FOLDER", help="The folder of the scenes."),
            of("--scenes", type=int, nargs="+", metavar="N", help="Scenes to write (default: 16)."),
            of("--results", type=Path, metavar="DIR", help="Depth by another decoder."),
            of("--by-material", action="store_true", help="Print rows for each material."),
        ],
    )
    for name, (help, options) in FIGURES.items():
        add(name, partial(run_figures, name), help, [*options, JSON])
    return parser.parse_args(words)


def run_figures(name: str, args: argparse.Namespace) -> int:
    words = {key: value for key, value in vars(args).items() if key not in ("run", "json", "plot")}
    own = importlib.import_module(f"{__package__}.{name}").measure(**words, show=show)
    show("")
    figures = {"benchmark": name} | circumstances() | own | {"peak_rss_bytes": peak_rss_bytes()}
    print(describe(figures))
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + "\n")
    if getattr(args, "plot", None):
        from .plots import draw

        draw(figures, args.plot)
    return 0


def circumstances() -> dict[str, object]:
    cpu = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    memory_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    own = {"cpu": cpu[1] if cpu else platform.machine(), "cores": os.cpu_count()}
    own |= {"memory_gib": round(memory_bytes / 2**30)}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {"date": now, "python": platform.python_version()} | own


def show(text: str) -> None:
    print(f"\r{text[:99]:<99}\r", end="", file=sys.stderr, flush=True)


def run_page(args: argparse.Namespace) -> int:
    from .page import SECTIONS, page

    if unknown := set(args.sections) - set(SECTIONS):
        words = f"no section {', '.join(unknown)}: choose from {', '.join(SECTIONS)}"
        print(f"error: {words}", file=sys.stderr)
        return 2
    commit = git(ROOT, "describe", "--always", "--dirty")
    return write(page(circumstances(), commit, args.sections), None if args.sections else args.out)


def write(sections: Iterable[tuple[str, str]], out: Path | None) -> int:
    """Measure the sections, and write them to a page or, without a path, print them."""
    texts = []
    for number, (heading, text) in enumerate(sections):
        show(f"{heading} is measured")
        paragraphs = [
            textwrap.fill(part, 120, break_on_hyphens=False) if part[0] != "|" else part
            for part in text.strip().split("\n\n")
        ]
        texts.append(f"{'##' if number else '#'} {heading}\n\n" + "\n\n".join(paragraphs) + "\n")
    show("")
    if out is not None:
        out.write_text("\n".join(texts), encoding="utf-8")
    print(out or "\n".join(texts))
    return 0


def run_sigma(args: argparse.Namespace) -> int:
    from .sigma import honesty

    text = honesty(show)
    show("")
    print(text)
    return 0


def run_shelf(args: argparse.Namespace) -> int:
    from graycast.rig.shelf import SHELF

    from . import shelf

    names = args.names or list(SHELF)
    if args.pictures is not None:
        shelf.draw_all(names, args.pictures)
        print(args.pictures)
        return 0
    commit = git(ROOT, "describe", "--always")
    figures = shelf.measure_all(names, args.resolution, commit, show)
    show("")
    page = ROOT / "docs" / "reference" / "shelf.md"
    page.write_text(shelf.with_table(page.read_text(), figures))
    print(page)
    return 0


def run_swatches(args: argparse.Namespace) -> int:
    from . import swatches

    swatches.draw(args.out, show)
    show("")
    print(args.out)
    return 0


def run_caustics(args: argparse.Namespace) -> int:
    from . import caustics

    if args.picture is not None:
        caustics.draw(args.picture, args.samples)
        print(args.picture)
        return 0
    for figures in caustics.rows():
        print(describe(figures), flush=True)
        print()
    return 0


def run_decoders(args: argparse.Namespace) -> int:
    from graycast.base.errors import GraycastError

    from . import decoder_comparison, decoder_scenes

    foreign = "--results or --by-material" if args.action == "write" else "--scenes"
    if args.scenes if args.action == "compare" else args.results or args.by_material:
        print(f"error: {args.action} takes no {foreign}", file=sys.stderr)
        return 2
    try:
        if args.action == "write":
            numbers = args.scenes or range(len(decoder_scenes.SCENES))
            for path in decoder_scenes.write_scenes(
                args.folder, numbers, on_scene=lambda number: show(f"scene {number}")
            ):
                print(path)
            return 0
        rows = []
        for row in decoder_comparison.compared(args.folder, args.results):
            show(f"{row.material}, {row.code}: {row.decoder}")
            rows.append(row)
        print(decoder_comparison.table(rows, by_material=args.by_material))
    except GraycastError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def run_materials(args: argparse.Namespace) -> int:
    from . import materials

    rows = []
    for row in materials.measured(args.resolution):
        rows.append(row)
        show(f"{row.scanner}, {row.material}, {row.code}: {row.words}")
    about = {"commit": git(ROOT, "describe", "--always", "--dirty"), "resolution": args.resolution}
    return write(materials.page(rows, **circumstances(), **about), args.out)


def main(words: list[str] | None = None) -> int:
    args = parsed(words)
    return args.run(args)


def run_compare(args: argparse.Namespace) -> int:
    settings = {"stages": args.stages, "minutes": args.minutes, "path": args.path}
    present = {"here": git(ROOT, "rev-parse", "HEAD"), "changed": git(ROOT, "status", "--short")}
    try:
        records = compare(ROOT, args.rev, **settings, on_progress=show)
    except CompareError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130  # The other tree is already removed, and its process has ended.
    show("")
    rows = summarise(records)
    print(table(rows))
    if args.json:
        commits = present | {"there": commit_of(ROOT, args.rev)}
        figures = commits | circumstances() | {"rows": rows, "records": records}
        args.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    # `timeout` sends SIGTERM, which must end the benchmark like Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
