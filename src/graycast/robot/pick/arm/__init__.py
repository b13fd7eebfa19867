"""The arm of the robot: its joints and shapes, its obstacles, and its paths.

arms, robot   the built-in arms; kinematics and collision checks
obstacles     bin, table, rig and measured heap as shapes for collision checks
motion, ways  collision-free paths, and the paths of one pick
"""
