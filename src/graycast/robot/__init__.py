"""From a detection with depth to a picked part.

Each imports only from those above it:

    grasp            where a part can be gripped by suction cups or jaws
    pose             the pose of a part from a detection and the scanner's depth, and how well the
                     two agree (`agreement`)
    pick             a robot that empties the bin
    grasp_labels     grasp labels of the parts of a dataset, simulated in physics
"""
