"""Datasets that are read back, simulated or real, with detections and poses found in them.

example        one picture and its labels as arrays for training
rescanned      other datasets with the scanner depth of `graycast rescan`
real           datasets of real pictures
stored         a dataset that is read back, simulated or real
scene_content  all data of one image in memory, for statistics, pages and scores
detections     the detections in a picture, and COCO's results files
pose_results   estimated poses, and BOP's results files
"""
