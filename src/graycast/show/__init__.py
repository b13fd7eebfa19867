"""Pictures and pages for people.

Each module imports only from those above it:

    report           pictures of inputs and results, and web pages
    scenes           scenes for use in a script or a notebook
    live             a cell in the browser, whose settings can be changed
"""
