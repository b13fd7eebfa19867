"""Commands about which scanner to take: design."""

import argparse
from pathlib import Path

from rich.markup import escape

from .arguments import add_command, add_device, add_workers, progress_bar, workers_of

# Heavy modules are imported by the command that needs them, so that --help answers at once.

DESIGN = """\
Compare scanners, their places, codes, exposures and bins on the same heaps of parts. Of each
setting of the study it tells which share of the parts' surface is measured, how exactly, what is
missing and why, the smallest feature that is seen, and the seconds of a scan; and in a sentence
which setting to take. The folder gets tables, a plot of the best settings, and a picture of each
setting. The same command goes on where it was stopped, also with more settings or heaps."""


def add_commands(commands) -> None:
    design = add_command(commands, "design", _design, "Find which scanner to take, and where.")
    design.description = DESIGN
    design.set_defaults(when_stopped="finished scans are kept")
    design.add_argument(
        "study", type=Path, help="The study, a YAML file; configs/design/brackets.yaml is one."
    )
    design.add_argument("--out", type=Path, required=True, help="The folder of the study.")
    design.add_argument("--list", action="store_true", help="Only list the settings; scan nothing.")
    add_device(design)
    add_workers(design, "scans are made")


def _design(options: argparse.Namespace) -> int:
    from ..design import read_design, run_design, settings_of, write_design

    workers = workers_of(options)
    spec = read_design(options.study)
    settings = settings_of(spec)
    if options.list:
        print("\n".join(setting.name for setting in settings))
        return 0
    print(f"{len(settings)} settings, {spec.layouts} heaps of parts, seed {spec.seed}")
    with progress_bar() as bar:
        scans = bar.add_task("scans", total=None)
        stage = bar.add_task("", total=None, visible=False)

        def made(name, layout, outcome) -> None:
            bar.update(scans, advance=1)
            shares = ", ".join(f"{share:.1%}" for share in outcome.reasons.values())
            bar.console.print(
                f"{name}  heap {layout:03d}  {outcome.seconds:6.1f} s  {shares} measured"
            )

        def failed(name, layout, outcome) -> None:
            told = " ".join(str(outcome.error).split()) or type(outcome.error).__name__
            bar.console.print(f"{name}  heap {layout:03d}  failed: {told}", markup=False)

        lost = run_design(
            spec,
            options.out,
            device=options.device,
            workers=workers,
            on_start=lambda found, total: bar.update(scans, completed=found, total=total),
            on_made=made,
            on_failed=failed,
            on_stage=lambda text: bar.reset(
                stage, description=escape(text), total=None, visible=True
            ),
        )
    said = write_design(spec, options.out)
    print((options.out / "table.md").read_text(encoding="utf-8"))
    print(said)
    for name in lost:
        print(f"  {name} is missing; the same command tries it again")
    return 1 if lost else 0
