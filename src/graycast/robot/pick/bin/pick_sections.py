"""Settings of a robot's cell: a dataset's configuration plus robot, tool and picking."""

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from ....base.settings import Level, Positive, Settings, Share, Vector, read_settings
from ....cell.config import Config
from ..arm.arms import ARMS
from ..tool.suction_tool import SuctionTool
from ..tool.tools import AnyTool


class RobotSection(Settings):
    """Settings of the arm and of the position of its base."""

    arm: str = Field(
        default="ur5e",
        description=f"The arm is {', '.join(ARMS)}, or a URDF file with a link called flange.",
    )
    base_m: Vector = Field(
        default=(-0.45, 0.0, 0.0),
        description="The position of the arm's base relative to the "
        "middle of the bin's floor, in metres.",
    )
    base_yaw_deg: float = Field(
        default=0.0, description="The rotation of the arm's base about the vertical, in degrees."
    )
    home_rad: tuple[float, ...] | None = Field(
        default=None,
        description="The joint angles at the start in radians. Without this key, they "
        "are the arm's own.",
    )


class PickingSection(Settings):
    """Settings of the detection, the grips and the release of parts."""

    knows: Literal["part", "depth"] = Field(
        default="part",
        description="The source of the grips: part uses the part's model and pose, depth "
        "uses the depth map only.",
    )
    detector: str = Field(
        default="truth",
        description="The detector: truth, none, or a folder that graycast detector train wrote.",
    )
    pose: Literal["found", "truth"] = Field(
        default="found", description="The source of a part's pose."
    )
    depth: Literal["scanner", "perfect", "noisy"] = Field(
        default="scanner",
        description="The depth that the robot uses. noisy is perfect depth with Gaussian noise.",
    )
    depth_noise_m: Positive | None = Field(
        default=None, description="The standard deviation of the noise of noisy depth, in metres."
    )
    place_m: Vector = Field(
        default=(0.0, -0.45, 0.15),
        description="The position of the tool's tip where it releases a part, in metres.",
    )
    approach_m: Positive = Field(
        default=0.06,
        description="The length of the straight approach to a grip along the tool's "
        "axis, in metres.",
    )
    clear_m: Level = Field(
        default=0.05,
        description="The height above rim and heap to which a part is lifted before it "
        "is carried away, in metres.",
    )
    straight_m_s: Positive = Field(
        default=0.25, description="The speed on straight paths in metres per second."
    )
    lift_off_m_s: Positive = Field(
        default=0.05, description="The speed of the first 10 mm of the lift, in metres per second."
    )
    most_lean_deg: float = Field(
        default=40.0,
        gt=0,
        le=80,
        description="The largest angle between the tool's axis and the vertical.",
    )
    least_score: Share = Field(
        default=0.25, description="The lowest score of a grip that the robot tries."
    )
    targets: int = Field(
        default=3,
        ge=1,
        description="The number of detections for which grips are planned together, "
        "the highest first.",
    )
    grips: int = Field(
        default=12, ge=1, description="The largest number of grips that are planned for a scan."
    )
    failures: int = Field(
        default=5,
        ge=1,
        description="The number of consecutive scans without a "
        "pick after which the robot leaves a bin.",
    )
    hand_eye_m: Level = Field(
        default=0.5e-3,
        description="The standard deviation of the hand-eye calibration's error "
        "along each axis, in metres.",
    )
    hand_eye_rad: Level = Field(
        default=1e-3,
        description="The standard deviation of the hand-eye "
        "calibration's error about each axis, in "
        "radians.",
    )
    readout_s: Level = Field(
        default=0.010,
        description="The time that the scanner needs to read out a frame, in seconds, "
        "in addition to the exposure.",
    )

    @model_validator(mode="after")
    def _whole(self) -> "PickingSection":
        if (self.depth == "noisy") != (self.depth_noise_m is not None):
            raise ValueError(
                "depth: noisy and depth_noise_m are used only together: give both or neither"
            )
        if self.knows == "part" and self.detector == "none":
            raise ValueError(
                "knows: part needs a detector: give truth or a folder as detector, or give "
                "knows: depth"
            )
        return self


class PickConfig(Config):
    """A robot's cell: a dataset's configuration with the keys robot, tool and picking."""

    robot: RobotSection = RobotSection()
    tool: AnyTool = SuctionTool()
    picking: PickingSection = PickingSection()

    @model_validator(mode="after")
    def _possible(self) -> "PickConfig":
        if self.domain is not None:
            raise ValueError("the cell of a robot does not vary: remove domain")
        if self.picking.knows == "depth" and self.tool.in_depth is None:
            raise ValueError(
                f"{self.tool.kind} need a known model: give picking.knows: part, or a suction tool"
            )
        return self


def load_pick_config(path: Path | str) -> PickConfig:
    """Read and check the configuration of a robot's cell.

    Raises:
        ConfigError: the file is missing, is not YAML, or has an unknown or wrong key.
    """
    return read_settings(Path(path), PickConfig)
