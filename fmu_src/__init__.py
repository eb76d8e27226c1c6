"""Export of models as FMUs."""

from hesr_model.support.lazy import lazy

__getattr__, __dir__ = lazy(__name__, __file__)
__all__ = __dir__()
