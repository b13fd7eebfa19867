"""Measurement and comparison of scanners, detectors, poses and views.

Each package imports only from the packages above it:

    metrology        the accuracy of a virtual scanner, as a certificate
    evaluate         scores of detections, of poses (`pose_recall`, `pose_errors`) and of measured
                     depth (`depth`); it imports no code that it scores
    merge            fusion of several views into one cloud, and the surface that each view adds
    design           comparison of scanners and of scanner poses on the same heaps of parts
"""
