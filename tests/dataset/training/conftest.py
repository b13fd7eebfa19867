from simulated_dataset import exported, made, master, samples

__all__ = ["exported", "made", "master", "samples"]
