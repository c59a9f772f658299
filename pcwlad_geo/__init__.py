"""Sub-pixel registration of multimodal rasters.

`open`, `match` and `fit` are the steps of a registration, and `Correction.warp` applies what they find; they
take files, open datasets, arrays and xarray.DataArrays. `register` does the whole job, and writes its folder
where one is asked for; `batch` does many; `stack` brings many images of one ground into one frame, and
`watch` tells what they do over time; `warp` applies what `register` has found to other bands; `qa` measures
how well the bands of a scene lie on each other.
The heavy libraries load when a name is first used, so that ``pcwlad-geo --help`` answers at once.
"""

import lazy_loader

from pcwlad_geo.dropped_names import DROPPED

__version__ = "1.0.0rc1"

_lazy, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = sorted([*__all__, "__version__"])


def __getattr__(name: str) -> object:
    """Return a public name, which is loaded now; say of one that was dropped what takes its place."""
    if name in DROPPED:
        raise AttributeError(f"pcwlad_geo.{name} is no longer public: {DROPPED[name]}", name=name)
    return _lazy(name)
