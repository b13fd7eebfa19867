"""Measurement and comparison of scanners, detectors, poses and views.

Each imports only from those above it:

    metrology        the accuracy of a virtual scanner, as a certificate
    evaluate         scores of detections, of poses (`pose_recall`, `pose_errors`) and of scanner
                     depth against perfect depth (`depth`); imports nothing that it scores
    merge            several views of a scene as one cloud, and what each of them adds
    design           comparison of scanners and their poses on the same heaps
"""
