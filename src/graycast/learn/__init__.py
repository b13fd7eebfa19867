"""Detectors, and studies that compare detectors and their training sets.

Each module imports only from the modules above it:

    detect           detectors: training and inference
    study_file       the YAML file of a study
    study            runs over models x inputs x training sets x test sets x seeds, and one table
"""
