"""The command `graycast`: files in, files out.

arguments            the table of the flags that several commands share
bars                 progress and the time that is left
start_commands       demo, new, doctor, schema
scene_commands       preview, generate, live, validate, report, parts
rescan_command       rescan
dataset_commands     the group dataset
detector_commands    the group detector
robot_commands       the group robot
rig_commands         the group rig
real_commands        the group real
doctor               what this machine has
command              the program: groups, help and errors
"""

from .command import main

__all__ = ["main"]
