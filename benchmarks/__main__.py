"""`python -m benchmarks --help` and the `--help` of its commands explain themselves."""

import argparse
import json
import os
import platform
import re
import signal
import sys
import textwrap
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from .compare import CompareError, commit_of, compare, git, summarise, table
from .page import page
from .stages import STAGES

ROOT = Path(__file__).resolve().parents[1]
HELP = """\
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


PAGE = """\
Measure every figure of docs/benchmarks.md, and write the page with the date, the commit and the
machine. It takes 8 minutes on two processors, which should have nothing else to do."""

SIGMA = """\
Print the error of depth in its own sigmas (the 68 % quantile) for four codes and 1 to 64 light
paths a pixel: first as the code alone states sigma, then with the renderer's share, and the share
of pixels that are off by more than five sigmas, if there are any. The leaning wall is compared with
its true depth; of the two facing walls, two renderings are compared with each other, except under
plain Gray code. It takes about 3 minutes on two processors."""

MATERIALS = """\
Measure the share of right and wrong depth on eight materials for each scanner and for each code,
and write docs/materials.md. It takes about half an hour on two processors."""


def parsed(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser(
        "compare",
        help="Time all stages against those of another commit.",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    one.set_defaults(run=run_compare)
    one.add_argument("rev", metavar="REV", help="The other commit, by its hash, a tag or a branch.")
    one.add_argument(
        "--minutes",
        type=float,
        default=10,
        metavar="M",
        help="A round is begun if it fits into this time; two rounds always run (default: 10).",
    )
    one.add_argument(
        "--stages",
        type=stages,
        default=STAGES,
        metavar="S,...",
        help=f"The stages that are timed, out of {', '.join(STAGES)} (default: all of them).",
    )
    one.add_argument(
        "--path",
        type=Path,
        metavar="DIR",
        help="A folder with packages that only the other commit needs; fill it with "
        "pip install --no-deps --target DIR.",
    )
    one.add_argument(
        "--json", type=Path, metavar="FILE", help="A file to which all figures are written."
    )
    other = commands.add_parser(
        "page", help="Measure every figure of docs/benchmarks.md.", description=PAGE
    )
    other.set_defaults(run=run_page)
    add_out(other, "docs/benchmarks.md")
    third = commands.add_parser(
        "sigma",
        help="Compare the depth errors of simulated scans with the stated sigma.",
        description=SIGMA,
    )
    third.set_defaults(run=run_sigma)
    fourth = commands.add_parser(
        "materials",
        help="Measure the share of wrong depth on matt, plastic, dark and metal parts.",
        description=MATERIALS,
    )
    fourth.set_defaults(run=run_materials)
    fourth.add_argument(
        "--resolution",
        choices=("small", "low", "full"),
        default="low",
        help="The resolution of the scanners (default: low).",
    )
    add_out(fourth, "docs/materials.md")
    return parser.parse_args(words)


def add_out(parser: argparse.ArgumentParser, page: str) -> None:
    words = f"The file to which the page is written (default: {page})."
    parser.add_argument("--out", type=Path, default=ROOT / page, metavar="FILE", help=words)


def stages(text: str) -> list[str]:
    chosen = text.split(",")
    if unknown := set(chosen) - set(STAGES):
        message = f"no stage {', '.join(sorted(unknown))}: choose from {', '.join(STAGES)}"
        raise argparse.ArgumentTypeError(message)
    return chosen


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
    commit = git(ROOT, "describe", "--always", "--dirty")
    return write(args.out, page(ROOT, circumstances(), commit))


def write(out: Path, sections: Iterable[tuple[str, str]]) -> int:
    """Write a page of headings and texts as they are measured."""
    texts = []
    for number, (heading, text) in enumerate(sections):
        show(f"{heading} is measured")
        paragraphs = [
            textwrap.fill(part, 120, break_on_hyphens=False) if part[0] != "|" else part
            for part in text.strip().split("\n\n")
        ]
        texts.append(f"{'##' if number else '#'} {heading}\n\n" + "\n\n".join(paragraphs) + "\n")
    show("")
    out.write_text("\n".join(texts), encoding="utf-8")
    print(out)
    return 0


def run_sigma(args: argparse.Namespace) -> int:
    from .sigma import honesty  # the package under test: `compare` must not load it

    text = honesty(show)
    show("")
    print(text)
    return 0


def run_materials(args: argparse.Namespace) -> int:
    from . import materials  # the package under test: `compare` must not load it

    rows = []
    for row in materials.measured(args.resolution):
        rows.append(row)
        show(f"{row.scanner}, {row.material}, {row.code}: {row.words}")
    about = {"commit": git(ROOT, "describe", "--always", "--dirty"), "resolution": args.resolution}
    return write(args.out, materials.page(rows, date=circumstances()["date"], **about))


def main(words: list[str] | None = None) -> int:
    args = parsed(words)
    return args.run(args)


def run_compare(args: argparse.Namespace) -> int:
    chosen = {"stages": args.stages, "minutes": args.minutes, "path": args.path}
    present = {"here": git(ROOT, "rev-parse", "HEAD"), "changed": git(ROOT, "status", "--short")}
    try:
        records = compare(ROOT, args.rev, **chosen, on_progress=show)
    except CompareError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130  # the other tree is gone, and its process with it
    show("")
    rows = summarise(records)
    print(table(rows))
    if args.json:
        commits = present | {"there": commit_of(ROOT, args.rev)}
        figures = commits | circumstances() | {"rows": rows, "records": records}
        args.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `timeout` ends it like Ctrl-C
    sys.exit(main())
