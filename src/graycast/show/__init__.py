"""What a person looks at.

Each imports only from those above it:

    report           pictures of inputs and results, and the web page
    scenes           scenes for a script or a notebook
    live             a cell in the browser, whose settings can be changed
"""
