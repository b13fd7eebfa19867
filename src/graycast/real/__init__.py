"""Data of real scanners, and third-party datasets.

Each module imports only from modules above it:

    depth_file     depth maps, pictures and camera matrices from files of any scanner
    depth_sense    checks of depth: unit, filled holes, z or ray lengths
    depth_solid    a depth map as a solid for a scene: surface, edges, sides
    fitted_config  a configuration in which some keys are replaced by fitted values
    picture_pairs  colour, brightness and depth of one picture, paired by file names
    calibrate      a rig, or its pose on a robot, from pictures of a board
    realism        statistics of noise and gaps in real depth, which perfect depth lacks
    fit_bin        pose, colours and light of a real bin, fitted to scans of it
    import_real    real pictures with labels, imported as a dataset
    material       base colour, roughness and kind of a surface from one scan
    rescan         simulated scanner depth for third-party datasets that have perfect depth
    twin           a simulated scanner whose scans have the statistics of real scans
"""
