"""Commands about this machine and this program: doctor, schema."""

import argparse
import json

from .arguments import add_command


def add_commands(commands) -> None:
    add_command(
        commands,
        "doctor",
        _doctor,
        "List what Graycast can use on this machine, what is missing, and what each missing "
        "piece is for.",
    )
    schema = add_command(
        commands,
        "schema",
        _schema,
        "Print the JSON Schema of a kind of file, with which editors complete and check it.",
    )
    schema.add_argument(
        "kind",
        choices=("config", "rig", "stack", "study", "design"),
        help="The kind of file.",
    )


def _doctor(options: argparse.Namespace) -> int:
    from .doctor import describe, examine

    print(describe(examine()))
    return 0


def _schema(options: argparse.Namespace) -> int:
    from ..camera.rig_file import rig_schema
    from ..camera.stack import stack_schema
    from ..cell.config import config_schema
    from ..learn.study_file import study_schema
    from ..score.design import design_schema

    schemas = {
        "config": config_schema,
        "rig": rig_schema,
        "stack": stack_schema,
        "study": study_schema,
        "design": design_schema,
    }
    print(json.dumps(schemas[options.kind](), indent=2))
    return 0
