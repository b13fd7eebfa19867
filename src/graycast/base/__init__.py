"""Foundations that every room uses: errors, files, settings, transforms and random streams.

Each module imports only from the modules above it:

    version          the version of Graycast, which its output files state
    errors           the errors that a caller may want to handle
    array_types      annotations of arrays with their axes
    progress         messages of a long task to the caller that waits for it
    argument_check   a type check of arguments; its errors name the argument
    public_value     text and help of public values, which refuse unknown keywords
    file_limits      checks of users' JSON and pictures, which could fill the memory
    folder           files and folders that are written completely or not at all
    plotting         the style of plots, and a function that writes them
    yaml_loader      a YAML loader that refuses duplicate keys and too many aliases
    section_help     the help page of a section of a file: its keys with units and defaults
    settings         YAML files: reading and checking, with errors of one line
    sections         sections of files from the fields of dataclasses
    spawn            processes that do not run the user's script again
    usage            time and memory that processes have used
    streams          independent streams of random numbers, derived from a seed
    robust           standard deviations on which outliers have little influence
    color            the colour encoding of all pictures on disk
    frames           rigid transforms, rotations, the pixel grid and units of length
    mask_box         the bounding box of a mask, and the overlap of a window and an image
    ply              point clouds and meshes as PLY files
    tables           tables as CSV and as Markdown
    kernels          functions that Numba compiles
"""
