"""Writers of a dataset: pictures, labels, models, and scenes that are complete or absent.

coco           annotations of COCO: masks as run lengths
picture_bytes  depth, modulation and masks as PNG files
models         parts as BOP object models
claim          `graycast.json`: the configuration with which a folder was made
flow           flow to each picture of a scan that moves
raw            captured pictures, code maps and flow
bop            a scene as the files of a BOP scene folder
set_aside      the scenes that failed in every attempt and were given up
store          a dataset's folder while scenes are written, each completely or not at all
"""
