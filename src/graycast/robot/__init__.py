"""Robots: grips on parts, poses of parts, and picks from a bin.

Each package imports only from the packages above it:

    grasp            places at which suction cups or jaws can grip a part
    pose             estimation of a part's pose from a detection and the scanner's depth, and how
                     well a pose agrees with the depth
    pick             a simulated robot that empties a bin
    grasp_labels     grasp labels for the parts in a dataset, with simulated physics
"""
