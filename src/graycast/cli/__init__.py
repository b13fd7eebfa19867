"""The command `graycast`: files in, files out.

Each imports only from those above it:

    bars               progress and the time that is left
    doctor             what this machine has
    readers            readers of numbers, sizes and lengths that refuse any other text
    arguments          the table of the flags that several commands share
    dataset_commands   the group dataset
    detector_commands  the group detector
    material_command   real material
    real_commands      the group real
    rescan_command     rescan
    parts_command      parts
    rig_commands       the group rig
    start_commands     demo, new, doctor, schema
    scene_commands     preview, generate, live, validate, report
    robot_commands     the group robot
    command            the program: groups, help and errors
"""

from .command import main

__all__ = ["main"]
