"""From a configuration in YAML to a scene, and to a dataset of many scenes.

Each imports only from those above it:

    domain           how scenes differ from their cell, and a record of the differences
    views            the camera poses of a scene's images
    motion           motion of belt, rig and parts during a scan, and the times of its pictures
    config           the configuration in YAML, and the values that it resolves to
    stored_bin       the bin of a stored dataset
    framing          how much of a picture a bin and a part cover; the scanner that fits a bin
    new_cell         a commented configuration for one part
    resolve          a configuration with its files' contents, shared by all scenes
    metering         the region of a picture from which a scanner meters its exposure
    moving_parts     parts that move on their own, and the flow of all points
    moving_light     the light of a moving scene in each picture, from few renders
    scanner_device   what a program calls of a scanner, and the frame that it receives
    bag_scanner      the scanner of a ROS 2 bag, with the same calls
    simulate         one scene, from its seeds (`base.streams`) to its sample
    virtual_bin      a bin that lives on while its parts are lifted, shaken and replaced
    virtual_scanner  a cell as a device, with the calls that makers' Python classes have
    remedies         changed settings that give the parts more depth, tried on a scene's light
    engine           workers that make scenes: this process, other processes, or a cluster
    generate         many scenes of a cell in the folder of a dataset (`dataset.write.store`), and
                     the missing scenes of a stopped run
"""
