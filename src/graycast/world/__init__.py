"""The simulated world: parts, a bin, the scene, and how the parts fall.

Each module imports only from the modules above it:

    parts            meshes with materials, built in or from the user's files
    bins             a bin from a mesh file
    scene            the world before physics and light, and the layout of the parts
    drop             parts fall until they rest: Scene -> Layout
"""
