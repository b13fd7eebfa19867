"""Datasets on disk in BOP's and COCO's formats, written scene by scene, read back and checked.

Each module imports only from those above it:

    json_text      how this package writes JSON
    sample         the products of one image, as the writers take them
    records        the JSON files as values: every key, its shape and its unit
    safe_reading   reading of files that may be damaged
    set_aside      the scenes that failed in every attempt and were given up
    places         the layout of the folder, and the rule for a finished scene
    detections     the detections in a picture, and COCO's results files
    coco           annotations of COCO: masks as run lengths
    example        one picture and its labels as arrays for training
    picture_bytes  depth, modulation and masks as PNG files
    pose_results   estimated poses, and BOP's results files
    models         parts as BOP object models
    scene_folder   the names of a scene's files
    seal           the SHA-256 of each file, which reveals a change
    rescanned      other datasets with the scanner depth of `graycast rescan`
    plain_scene    one image and its records as they are stored, for the checks
    claim          `graycast.json`: the configuration with which a folder was made
    raw            captured pictures and code maps
    real           datasets of real pictures
    rescan_check   checks of what `graycast rescan` added
    grasp_files    grasp labels: their files, read and checked
    mask_check     checks of masks, counts and boxes against the posed models
    bop            a scene as the files of a BOP scene folder
    raw_check      checks of captured pictures and code maps
    stored         a dataset that is read back, simulated or real
    store          a dataset's folder while scenes are written, each completely or not at all
    scene_check    checks of one scene folder
    export         datasets in the formats of other programs
    scene_content  all data of one image in memory, for statistics, pages and scores
    checking       `validate`: the checks of a dataset from its files alone
    training       training examples from datasets and from exports
    stats          statistics of a dataset, including its depth errors
    card           the card of a dataset
"""
