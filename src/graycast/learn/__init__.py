"""Detectors, and studies of what they learn from.

Each imports only from those above it:

    detect           detectors: training and inference
    study_file       the YAML file of a study
    study            models x inputs x training sets x worlds x seeds, in one table
"""
