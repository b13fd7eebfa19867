"""The second back end: Blender Cycles, one render for each projected pattern, as in the paper.

Cycles lives in an environment of its own (`make cycles`) and in a child process; this package is
Graycast's side of it (`renderer.CyclesRenderer`), `worker/` is Cycles'.
"""

from .process import CyclesState, examine_cycles

__all__ = ["CyclesState", "examine_cycles"]
