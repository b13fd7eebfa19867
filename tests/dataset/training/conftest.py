from simulated_dataset import exported, master, master_and_samples, samples

__all__ = ["exported", "master", "master_and_samples", "samples"]
