"""The science of HESR: logs, rigid bodies, friction laws and their fits.

Names for notebooks (`docs/tutorial.ipynb`), imported on first use.
"""

from hesr_model.support.lazy import lazy_stub

__getattr__, __dir__ = lazy_stub(__name__, __file__)
__all__ = __dir__()
