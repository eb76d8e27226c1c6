"""The science of HESR: logs, rigid bodies, friction laws and their fits.

Users import `hesr`. The names here, imported on first use, are short forms for HESR's own modules
and tests; they may change.
"""

from hesr_model.support.lazy import lazy

__getattr__, __dir__ = lazy(__name__, __file__)
__all__ = __dir__()
