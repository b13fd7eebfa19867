"""Programs that make figures, worlds and pictures of docs/: `python -m studies.NAME --help`."""
