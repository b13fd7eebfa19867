"""Foundations that every room uses: errors, files, settings, transforms and random streams.

Each imports only from those above it:

    version          the version of Graycast, which the files that it writes state
    errors           the errors that a caller may want to handle
    array_types      annotations of arrays with their axes
    progress         what a long task tells whoever waits for it
    argument_check   wrong kinds of arguments, refused with their names
    public_value     what a public value says of itself: text, help, unknown keywords
    file_limits      JSON and pictures of users, refused before they fill the memory
    folder           files and folders that are written completely or not at all
    plotting         the style of plots, and how they are written
    yaml_loader      YAML without keys given twice and without aliases that fill the memory
    section_help     the help page of a section of a file: its keys with units and defaults
    settings         YAML files: reading, checking, and errors of one clear line
    sections         sections of files from the fields of dataclasses
    spawn            processes that do not run the user's script again
    usage            time and memory that processes have used
    streams          independent streams of random numbers, by the seed that they are of
    robust           standard deviations that outliers do not spoil
    color            the colour encoding of all pictures on disk
    frames           rigid transforms, rotations, the pixel grid and units of length
    mask_box         the box about a mask's pixels, and where a window and an image overlap
    ply              point clouds and meshes as PLY files
    tables           tables as CSV and as Markdown
    kernels          functions that Numba compiles
"""
