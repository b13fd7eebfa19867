"""What a user writes of a robot's cell: all of a dataset's cell, and robot, tool and picking."""

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from ..config import Config
from ..settings import Level, Positive, Settings, Share, Vector, read_settings
from .arms import ARMS
from .tools import JawTool, SuctionTool


class RobotSection(Settings):
    """An arm and where it stands."""

    arm: str = Field(
        "ur5e",
        description=f"The arm is {', '.join(ARMS)}, or a URDF file with a link called flange.",
    )
    base_m: Vector = Field(
        (-0.45, 0.0, 0.0), description="Where its base stands, from the middle of the bin's floor."
    )
    base_yaw_deg: float = 0.0
    home_rad: tuple[float, ...] | None = Field(
        None, description="The joint angles at the start. Left out, they are the arm's own."
    )


class PickingSection(Settings):
    """How parts are found, gripped and put away."""

    knows: Literal["part", "depth"] = Field(
        "part",
        description="Grips come from the part's model and pose, or from the depth alone.",
    )
    detector: str = Field(
        "truth",
        description="What finds parts: truth, none, or a folder that graycast train has written.",
    )
    pose: Literal["found", "truth"] = Field("found", description="Where a part's pose comes from.")
    depth: Literal["scanner", "perfect", "noisy"] = Field(
        "scanner",
        description="What the robot acts on. Noisy is perfect depth with Gaussian noise.",
    )
    depth_noise_m: Positive | None = Field(
        None, description="The standard deviation of noisy depth."
    )
    place_m: Vector = Field((0.0, -0.45, 0.15), description="Where the tool's tip lets a part go.")
    approach_m: Positive = Field(
        0.06, description="How long the straight way along the tool's axis to a grip is."
    )
    clear_m: Level = Field(
        0.05, description="How far a part is lifted above rim and heap before it is carried away."
    )
    straight_m_s: Positive = Field(0.25, description="The speed on straight ways.")
    lift_off_m_s: Positive = Field(
        0.05, description="The speed of the first 10 mm up, while the weight comes on the tool."
    )
    most_lean_deg: float = Field(
        40.0, gt=0, le=80, description="The largest angle between the tool's axis and the vertical."
    )
    least_score: Share = Field(0.25, description="The least score of a grip that is tried.")
    targets: int = Field(
        3, ge=1, description="How many detections are looked at together, the highest first."
    )
    grips: int = Field(12, ge=1, description="How many grips are planned for each scan at most.")
    failures: int = Field(5, ge=1, description="How many scans in a row without a pick end a bin.")
    hand_eye_m: Level = Field(
        0.5e-3, description="The calibration's error along each axis, as one standard deviation."
    )
    hand_eye_rad: Level = Field(1e-3, description="The same about each axis.")
    readout_s: Level = Field(
        0.010, description="How long the scanner reads a frame out, beside its exposure."
    )

    @model_validator(mode="after")
    def _whole(self) -> "PickingSection":
        if (self.depth == "noisy") != (self.depth_noise_m is not None):
            raise ValueError("depth: noisy and depth_noise_m belong together: give both, or none")
        if self.knows == "part" and self.detector == "none":
            raise ValueError(
                "knows: part needs a detector to look for poses: give truth or a folder, or "
                "knows: depth"
            )
        return self


class PickConfig(Config):
    """A robot's cell: the keys of a dataset's configuration, and these."""

    robot: RobotSection = RobotSection()
    tool: SuctionTool | JawTool = Field(SuctionTool(), discriminator="kind")
    picking: PickingSection = PickingSection()

    @model_validator(mode="after")
    def _possible(self) -> "PickConfig":
        if self.domain is not None:
            raise ValueError("a robot's cell stands as it is: remove domain")
        if self.picking.knows == "depth" and self.tool.kind == "jaws":
            raise ValueError("jaws need a known model: give picking.knows: part, or a suction tool")
        return self


def load_pick_config(path: Path) -> PickConfig:
    """Read and check a robot's cell.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown or wrong key.
    """
    return read_settings(path, PickConfig)
