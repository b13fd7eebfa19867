"""A small dataset on disk, shared with the tests of exports and of training."""

from simulated_dataset import exported, made, master, samples

__all__ = ["exported", "made", "master", "samples"]
