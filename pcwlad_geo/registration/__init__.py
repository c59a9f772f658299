"""A pair from files to its result: start, plan, matching, verdict and fit; `__init__.pyi` lists its front."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
