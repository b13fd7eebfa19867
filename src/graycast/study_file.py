"""What a study's YAML file says."""

import os
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from .export.split import Split
from .settings import Positive, Settings, Share, read_settings


class TestSection(Settings):
    """Sets of scenes that detectors are scored on; one for each part, or one for all."""

    datasets: tuple[Path, ...] = Field(min_length=1, description="folders, relative to the file")
    split: Literal["train", "val", "test", "all"] = Field(
        "all", description="test: the scenes that the training left, of its own dataset"
    )
    as_real: bool = Field(
        False, description="hide perfect depth: what was trained on it sees the scanner's"
    )


class ModelSection(Settings):
    """A network to train."""

    model: str = Field(description="as graycast train --model has it")
    backbone: str | None = Field(None, description="left out: the model's own")
    epochs: int | None = Field(None, ge=1, description="left out: the study's")
    learning_rate: Positive | None = Field(None, description="left out: the model's")
    seeds: tuple[int, ...] | None = Field(None, min_length=1, description="left out: the study's")


class EncodingSection(Settings):
    """How depth is told to a network; more than one make an ablation."""

    name: str = Field(description="in the table")
    holes: Literal["channel", "zero", "far"] = "channel"
    relief: bool = True


class StudySpec(Settings):
    """Detectors to train and worlds to score them in; each of all combinations is one run.

    Relative paths start at the file's folder.
    """

    title: str = Field("Study", description="of the table")
    models: tuple[ModelSection, ...] = Field(min_length=1)
    inputs: tuple[str, ...] = Field(min_length=1, description="as graycast train --input has them")
    encodings: tuple[EncodingSection, ...] = (EncodingSection(name="default"),)
    training: dict[str, tuple[Path, ...]] = Field(
        min_length=1, description="sets to learn from, by name: each some folders of datasets"
    )
    tests: dict[str, TestSection] = Field(min_length=1, description="worlds, by name")
    gap: tuple[str, str] | None = Field(None, description="a world and another: own less other")
    seeds: tuple[int, ...] = (0,)
    split: tuple[Share, Share, Share] = Field(
        (0.8, 0.1, 0.1), description="shares of train, val and test in the sets to learn from"
    )
    one_class: bool = Field(False, description="where something is, not what it is")
    epochs: int = Field(20, ge=1)
    longest_px: int = Field(320, ge=32, description="the longer side of a network's input")
    batch: int | None = Field(None, ge=1)
    min_visibility: Share = 0.1

    @model_validator(mode="after")
    def _known_worlds(self) -> "StudySpec":
        for name in self.gap or ():
            if name not in self.tests:
                raise ValueError(f"gap names {name!r}, which is none of {', '.join(self.tests)}")
        counts = {len(self.tests[name].datasets) for name in self.gap or ()}
        if len(counts) > 1:
            raise ValueError("gap: both worlds need as many datasets, of the same parts in turn")
        return self

    @property
    def division(self) -> Split:
        return Split(shares=self.split)


def read_study(path: Path) -> StudySpec:
    """Read and check a study; its paths become absolute, and one folder has one spelling.

    Raises:
        ConfigError: the file is missing, or has an unknown, missing or wrong key.
    """
    said = read_settings(path, StudySpec)
    base = path.parent.absolute()

    def spelt(folder: Path) -> Path:
        return Path(os.path.normpath(base / folder))

    changes: dict[str, Any] = {
        "training": {name: tuple(map(spelt, folders)) for name, folders in said.training.items()},
        "tests": {
            name: world.model_copy(update={"datasets": tuple(map(spelt, world.datasets))})
            for name, world in said.tests.items()
        },
    }
    return said.model_copy(update=changes)


def study_schema() -> dict[str, Any]:
    """JSON Schema of a study's file, from which editors complete."""
    return StudySpec.model_json_schema()
