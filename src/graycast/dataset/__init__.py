"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked.

Who only reads examples for training (`dataset.stored`) need not have what writing and checking
take, so this module imports nothing.

Beside what is written and read there is what else is done with a dataset:

    detections       what a detector finds in a picture, and COCO's results files
    pose_results     estimated poses, and BOP's results files
    stats            statistics of a dataset
    card             the card of a dataset
    export           datasets in the formats of other programs
    training         training examples from datasets and from exports
"""
