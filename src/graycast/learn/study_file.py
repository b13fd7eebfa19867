"""Settings in the YAML file of a study."""

import os
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from ..base.settings import Positive, Settings, Share, read_settings
from ..dataset.export.split import Split


class TestSection(Settings):
    """A test set: one dataset with all parts, or one dataset for each part."""

    datasets: tuple[Path, ...] = Field(
        min_length=1, description="Folders of datasets, relative to the study's file."
    )
    split: Literal["train", "val", "test", "all"] = Field(
        default="all",
        description="The set of scenes to score: test holds the scenes that the training did not "
        "use.",
    )
    as_real: bool = Field(
        default=False,
        description="Whether perfect depth is hidden, so that a detector trained on "
        "it gets the scanner's depth.",
    )


class ModelSection(Settings):
    """A network to train."""

    model: str = Field(
        description="The network, with a name as in graycast detector train --model."
    )
    backbone: str | None = Field(
        default=None, description="The backbone. Without this key, it is the model's own."
    )
    epochs: int | None = Field(
        default=None, ge=1, description="Without this key, it is the study's value."
    )
    learning_rate: Positive | None = Field(
        default=None,
        description="The highest learning rate. Without this key, it is the model's own.",
    )
    seeds: tuple[int, ...] | None = Field(
        default=None, min_length=1, description="Without this key, it is the study's value."
    )


class EncodingSection(Settings):
    """An encoding of depth for a network. Several encodings make an ablation study."""

    name: str = Field(description="The name of the encoding in the table.")
    holes: Literal["channel", "zero", "far"] = Field(
        default="channel",
        description="The encoding of missing depth: an additional channel, zero, or the far end of "
        "the range.",
    )
    relief: bool = Field(
        default=True,
        description="Whether a channel holds the height over the mean of the neighbourhood.",
    )
    p_wrong: bool = Field(
        default=False,
        description="Whether a channel holds the probability that the scanner's depth is wrong.",
    )


class StudySpec(Settings):
    """The detectors of a study and their test sets; each combination is one run.

    Relative paths start in the folder of the study's file.
    """

    title: str = Field(default="Study", description="The title of the table.")
    models: tuple[ModelSection, ...] = Field(min_length=1, description="The networks to train.")
    inputs: tuple[str, ...] = Field(
        min_length=1,
        description="The inputs of the networks, with names as in graycast detector train --input.",
    )
    encodings: tuple[EncodingSection, ...] = Field(
        default=(EncodingSection(name="default"),), description="The encodings of depth to compare."
    )
    training: dict[str, tuple[Path, ...]] = Field(
        min_length=1,
        description="The training sets by name; each is a list of folders of datasets.",
    )
    tests: dict[str, TestSection] = Field(min_length=1, description="The test sets by name.")
    gap: tuple[str, str] | None = Field(
        default=None,
        description="Two test sets; the table states the score in the first minus the score in "
        "the second.",
    )
    seeds: tuple[int, ...] = Field(default=(0,), description="The seeds; each one is a training.")
    split: tuple[Share, Share, Share] = Field(
        default=(0.8, 0.1, 0.1),
        description="The shares of train, val and test scenes in the training sets.",
    )
    one_class: bool = Field(
        default=False,
        description="Whether all parts are one class, so that the kind of a part is ignored.",
    )
    epochs: int = Field(default=20, ge=1, description="The number of passes over the training set.")
    longest_px: int = Field(
        default=320, ge=32, description="The longer side of the network's input picture in pixels."
    )
    batch: int | None = Field(
        default=None,
        ge=1,
        description="The number of pictures in a step. Without this key, it is the model's own.",
    )
    min_visibility: Share = Field(
        default=0.1, description="The visible share of an instance from which it counts."
    )

    @model_validator(mode="after")
    def _known_worlds(self) -> "StudySpec":
        for name in self.gap or ():
            if name not in self.tests:
                raise ValueError(
                    f"gap names {name!r}, which is no test set: choose two of "
                    f"{', '.join(self.tests)}"
                )
        counts = {len(self.tests[name].datasets) for name in self.gap or ()}
        if len(counts) > 1:
            raise ValueError(
                "gap: the two test sets must have the same number of datasets, with the same "
                "parts in the same order"
            )
        return self

    @property
    def division(self) -> Split:
        return Split(shares=self.split)


def read_study(path: Path) -> StudySpec:
    """Read and check a study; make its paths absolute and normalized.

    Raises:
        ConfigError: the file is missing, or has an unknown, missing or wrong key.
    """
    spec = read_settings(path, StudySpec)
    base = path.parent.absolute()

    def spelt(folder: Path) -> Path:
        return Path(os.path.normpath(base / folder))

    changes: dict[str, Any] = {
        "training": {name: tuple(map(spelt, folders)) for name, folders in spec.training.items()},
        "tests": {
            name: world.model_copy(update={"datasets": tuple(map(spelt, world.datasets))})
            for name, world in spec.tests.items()
        },
    }
    return spec.model_copy(update=changes)
