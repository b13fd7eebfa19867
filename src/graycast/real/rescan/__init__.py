"""A structured-light scan of scenes that others made: perfect depth in, scanner depth out.

source            what every layout gives: images with depth, colours, poses and models
"""
