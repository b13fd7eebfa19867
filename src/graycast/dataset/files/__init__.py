"""The files of a dataset: their names, their records, and the reading of damaged ones.

json_text     how this package writes JSON
sample        the products of one image, as the writers take them
records       the JSON files as values: every key, its shape and its unit
safe_reading  reading of files that may be damaged
places        the layout of the folder, and the rule for a finished scene
scene_folder  the names of a scene's files
seal          the SHA-256 of each file, which reveals a change
"""
