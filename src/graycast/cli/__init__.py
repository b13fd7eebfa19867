"""The command `graycast`, which reads and writes files.

Each module imports only from the modules above it:

    bars               progress bars with the remaining time
    doctor             the libraries and devices of this machine
    readers            readers of numbers, sizes and lengths that refuse any other text
    arguments          the table of shared flags, and functions for arguments
    dataset_commands   the group dataset
    detector_commands  the group detector
    material_command   real material
    real_commands      the group real
    rescan_command     rescan
    parts_command      parts
    hand_eye_command   rig hand-eye
    rig_commands       the group rig
    start_commands     demo, new, doctor, schema
    scene_commands     preview, generate, live, validate, report
    robot_commands     the group robot
    command            the program: groups, help and errors
"""

from .command import main

__all__ = ["main"]
