"""Options of grasp labels: the tool, and the number of labels."""

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from ...base.settings import Settings, check_settings, parse_yaml, read_text
from ..pick.tool.tools import AnyTool


class ToolFile(Settings):
    """A file that has only the key `tool`."""

    tool: AnyTool


class Labelling(Settings):
    """Options of a set of labels; each set of options belongs to a set of labels of its own."""

    tool: AnyTool
    places: int = Field(
        default=400, ge=1, description="The number of candidate grasps on each kind of part."
    )
    per_instance: int = Field(
        default=20, ge=1, description="The largest number of labels of an instance."
    )
    simulate: int = Field(
        default=10,
        ge=0,
        description="The number of labels of each scene that are simulated with physics.",
    )
    most_lean_deg: float = Field(
        default=40.0,
        gt=0,
        le=80,
        description="The largest angle between the tool's axis and the vertical, in degrees.",
    )

    @model_validator(mode="after")
    def _enough(self) -> "Labelling":
        if self.places < self.per_instance:
            raise ValueError(
                f"places is {self.places}: give at least per_instance, which is {self.per_instance}"
            )
        return self


def read_tool(path: Path) -> AnyTool:
    """Read the tool from a file: the configuration of a robot's cell, or only its section `tool`.

    Raises:
        ConfigError: the file is missing, is not YAML, or has a wrong key in its tool.
    """
    content = parse_yaml(read_text(path), path)
    section: Any = content.get("tool", content)
    if isinstance(section, dict):
        section = {"kind": "suction"} | section  # The configuration of a cell has the same default.
    return check_settings({"tool": section}, ToolFile, path).tool
