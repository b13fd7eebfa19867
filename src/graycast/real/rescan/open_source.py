from .bop_source import open_bop as open_source

__all__ = ["open_source"]
