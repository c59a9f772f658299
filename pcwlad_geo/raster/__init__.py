"""Raster files: grids, reading, masks, warping; `__init__.pyi` lists what the other rooms use of it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
