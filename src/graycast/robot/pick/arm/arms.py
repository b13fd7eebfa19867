"""The built-in robots: their URDF files, and their joint angles [rad] at the start."""

from math import pi
from pathlib import Path

URDF = Path(__file__).parent / "urdf"  # Each file names the source of its joints.
ARMS = {
    "ur5e": (0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0),
    "diana7": (0.0, -0.2, 0.0, pi / 2, 0.0, 0.2 - pi / 2, 0.0),
}
