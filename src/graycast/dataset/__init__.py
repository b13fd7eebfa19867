"""Ground truth on disk: BOP and COCO, written scene by scene, and read back to be checked.

Each imports only from those above it:

    json_text      how this package writes JSON
    sample         the products of one image, as writers take them
    records        the JSON files as values: every key, its shape and its unit
    safe_reading   files that are read without trust in them
    set_aside      which scenes of a folder were given up
    places         where things lie in the folder, and when a scene is finished
    detections     what a detector finds in a picture, and COCO's results files
    coco           annotations of COCO: masks as run lengths
    example        one picture and its labels as the arrays of a trainer
    picture_bytes  depth, modulation and masks as PNG files
    pose_results   estimated poses, and BOP's results files
    models         parts as BOP object models
    scene_folder   how the files of a scene are named
    seal           the SHA-256 of each file, which shows a change
    rescanned      datasets of others with the scanner depth of `graycast rescan`
    plain_scene    one image and its records as they are, for the checks
    claim          `graycast.json`: the configuration to which a folder belongs
    raw            captured pictures and code maps
    real           datasets of real pictures
    rescan_check   checks of what `graycast rescan` added
    grasp_files    grasp labels: their files, read and checked
    mask_check     checks of masks, counts and boxes against the models at their poses
    bop            a scene as the files of a BOP scene folder
    raw_check      checks of captured pictures and code maps
    stored         a dataset that is read back, simulated or real
    store          a dataset's folder while scenes are written: each is whole or not there
    scene_check    checks of one scene folder
    export         datasets in the formats of other programs
    scene_content  all of one image in memory, for statistics, pages and scores
    checking       `validate`: checks of a dataset by its files alone
    training       training examples from datasets and from exports
    stats          statistics of a dataset, and its error of depth
    card           the card of a dataset
"""
