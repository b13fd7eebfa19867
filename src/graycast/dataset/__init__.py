"""Datasets on disk in BOP's and COCO's formats, written scene by scene, read back and checked.

Each module imports only from those above it:

    files     the names of the files, their records, and the reading of damaged files
    read      a dataset that is read back, with detections and estimated poses
    write     pictures, labels and models on disk; each scene is written completely or not at all
    check     `validate`: the checks of a dataset from its files alone
    export    datasets in the formats of other programs
    training  training examples from datasets and from exports
    stats     statistics of a dataset, including its depth errors
    card      the card of a dataset
"""
