"""Checks of a dataset from its files alone.

plain_scene   one image and its records as they are stored, for the checks
model_check   object models: their files, read and checked
grasp_files   grasp labels: their files, read and checked
mask_check    checks of masks, counts and boxes against the posed models
raw_check     checks of captured pictures, code maps and flow
rescan_check  checks of what `graycast rescan` added
scene_check   checks of one scene folder
checking      `validate`: all checks of a dataset
"""
